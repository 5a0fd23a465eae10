rule calibrate:
    """Every load of a campaign, all loads together, and the general model beside the paper's.

    The other load cases lie beside the one of all loads, which is there of every campaign.
    """
    input:
        campaign=description_of,
        arm=arm_of_campaign,
        poses=result("ingest/poses.parquet"),
        base_frame=result("seed/base_frame.json"),
        named=named_effects,
        prior=SETTINGS.calibration.prior or [],
    output:
        result("calibration/combined.json"),
    log:
        result("logs/calibrate.log"),
    params:
        code=code_of("stages.calibrate"),
        folder=campaign_folder,
        settings=settings_of("calibration"),
        load="",
        out=folder_of_output,
        named=named_option,
        discovery=discovery_option,
    shell:
        "python -m pa10cal calibrate --campaign-dir {params.folder:q} --poses {input.poses:q}"
        " --base-frame {input.base_frame:q} --settings {params.settings:q} --out {params.out:q}"
        " {params.load} {params.named} {params.discovery} 2>&1 | tee {log:q} >&2"


use rule calibrate as calibrate_one with:
    output:
        result("calibration/{load}.json"),
    log:
        result("logs/calibrate_{load}.log"),
    wildcard_constraints:
        load=r"(?!combined\.json$)[^/]+",
    params:
        code=code_of("stages.calibrate"),
        folder=campaign_folder,
        settings=settings_of("calibration"),
        load="--load {load}",
        out=lambda wildcards, output: output[0],
        named=named_option,
        discovery=discovery_option,


# Where effects are those of the verdict, the search starts from a calibration without them.
use rule calibrate as calibrate_baseline with:
    input:
        campaign=description_of,
        arm=arm_of_campaign,
        poses=result("ingest/poses.parquet"),
        base_frame=result("seed/base_frame.json"),
        prior=SETTINGS.calibration.prior or [],
    output:
        result("baseline/combined.json"),
    log:
        result("logs/calibrate_baseline.log"),
    params:
        code=code_of("stages.calibrate"),
        folder=campaign_folder,
        settings=settings_of("calibration", without=("effects",)),
        load="",
        out=folder_of_output,
        named="",
        discovery="",

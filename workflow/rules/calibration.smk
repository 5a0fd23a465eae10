rule calibrate:
    """Every load of a campaign, all loads together, and the general model beside the paper's."""
    input:
        campaign=description_of,
        arm=arm_of_campaign,
        poses=result("ingest/poses.parquet"),
        base_frame=result("seed/base_frame.json"),
        named=named_effects,
        prior=SETTINGS.calibration.prior or [],
    output:
        directory(result("calibration")),
    log:
        result("logs/calibrate.log"),
    params:
        code=code_of("commands.calibrate"),
        folder=campaign_folder,
        settings=settings_of("calibration"),
        load="",
        named=named_option,
    shell:
        "python -m pa10cal calibrate --campaign-dir {params.folder:q} --poses {input.poses:q}"
        " --base-frame {input.base_frame:q} --settings {params.settings:q} --out {output:q}"
        " {params.load} {params.named} 2>&1 | tee {log:q} >&2"


use rule calibrate as calibrate_one with:
    output:
        result("calibration/{load}.json"),
    log:
        result("logs/calibrate_{load}.log"),
    params:
        code=code_of("commands.calibrate"),
        folder=campaign_folder,
        settings=settings_of("calibration"),
        load="--load {load}",
        named=named_option,


# Where effects are those of the verdict, the search starts from a calibration without them.
use rule calibrate as calibrate_baseline with:
    input:
        campaign=description_of,
        arm=arm_of_campaign,
        poses=result("ingest/poses.parquet"),
        base_frame=result("seed/base_frame.json"),
        prior=SETTINGS.calibration.prior or [],
    output:
        directory(result("baseline")),
    log:
        result("logs/calibrate_baseline.log"),
    params:
        code=code_of("commands.calibrate"),
        folder=campaign_folder,
        settings=settings_of("calibration", without=("effects",)),
        load="",
        named="",

rule calibrate:
    """Two-level calibration of one load case, or of all loads together."""
    input:
        campaign=raw("campaign.yaml"),
        arm=arm_of_campaign,
        poses=result("ingest/poses.parquet"),
        base_frame=result("seed/base_frame.json"),
        code=code_of("commands.calibrate"),
    output:
        result("calibration/{load}.json"),
    log:
        result("logs/calibrate_{load}.log"),
    params:
        folder=campaign_folder,
        settings=settings_of("calibration"),
    shell:
        "python -m pa10cal calibrate --campaign-dir {params.folder:q} --poses {input.poses:q}"
        " --base-frame {input.base_frame:q} --load {wildcards.load:q}"
        " --settings {params.settings:q} --out {output:q} 2>&1 | tee {log:q} >&2"

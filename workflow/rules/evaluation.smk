rule evaluate:
    """Uncalibrated, linear and cubic models on the held-out points and loads."""
    input:
        campaign=raw("campaign.yaml"),
        arm=arm_of_campaign,
        poses=result("ingest/poses.parquet"),
        calibration=result("calibration"),
        extended=result("discovery/extended.json"),
    output:
        result("evaluation/holdout.json"),
    log:
        result("logs/evaluate.log"),
    params:
        calibration=evaluated_calibration,
        code=code_of("commands.evaluate"),
        folder=campaign_folder,
    shell:
        "python -m pa10cal evaluate --campaign-dir {params.folder:q} --poses {input.poses:q}"
        " --calibration {params.calibration:q} --extended {input.extended:q} --out {output:q}"
        " 2>&1 | tee {log:q} >&2"

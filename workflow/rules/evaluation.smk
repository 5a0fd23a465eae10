rule evaluate:
    """Uncalibrated, linear and cubic models on the held-out points and loads."""
    input:
        campaign=raw("campaign.yaml"),
        arm=arm_of_campaign,
        poses=result("ingest/poses.parquet"),
        calibration=result(f"calibration/{SETTINGS.evaluation.calibration}.json"),
        extended=result("discovery/extended.json"),
        code=code_of("stages.evaluate"),
    output:
        result("evaluation/holdout.json"),
    log:
        result("logs/evaluate.log"),
    params:
        folder=campaign_folder,
    shell:
        "python -m pa10cal evaluate --campaign-dir {params.folder:q} --poses {input.poses:q}"
        " --calibration {input.calibration:q} --extended {input.extended:q} --out {output:q}"
        " 2>&1 | tee {log:q} >&2"

rule evaluate:
    """Uncalibrated, linear and cubic models on the held-out points and loads."""
    input:
        campaign=description_of,
        arm=arm_of_campaign,
        poses=result("ingest/poses.parquet"),
        calibration=result("calibration/combined.json"),
        extended=result("discovery/extended.json"),
    output:
        held_out=result("evaluation/holdout.json"),
        iso9283=result("evaluation/iso9283.json"),
    log:
        result("logs/evaluate.log"),
    params:
        calibration=evaluated_calibration,
        code=code_of("stages.evaluate"),
        folder=campaign_folder,
    shell:
        "python -m pa10cal evaluate --campaign-dir {params.folder:q} --poses {input.poses:q}"
        " --calibration {params.calibration:q} --extended {input.extended:q}"
        " --out {output.held_out:q} --iso9283 {output.iso9283:q} 2>&1 | tee {log:q} >&2"

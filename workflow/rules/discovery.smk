rule discover:
    """Where model and data disagree, which effect is missing, and the gap with it closed."""
    input:
        campaign=description_of,
        arm=arm_of_campaign,
        poses=result("ingest/poses.parquet"),
        calibration=searched_calibration,
    output:
        verdict=result("discovery/verdict.json"),
        analysis=result("discovery/analysis.json"),
        extended=result("discovery/extended.json"),
        covariance=result("discovery/extended.covariance.npz"),
        suggested=result("discovery/suggested_poses.csv"),
    log:
        result("logs/discover.log"),
    params:
        calibration=evaluated_calibration,
        code=code_of("stages.discover"),
        folder=campaign_folder,
        settings=settings_of("discovery"),
    shell:
        "python -m pa10cal discover --campaign-dir {params.folder:q} --poses {input.poses:q}"
        " --calibration {params.calibration:q} --settings {params.settings:q}"
        " --verdict {output.verdict:q} --analysis {output.analysis:q} --extended {output.extended:q}"
        " --suggested {output.suggested:q}"
        " 2>&1 | tee {log:q} >&2"

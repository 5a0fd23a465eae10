rule discover:
    """Where model and data disagree, which effect is missing, and the gap with it closed."""
    input:
        campaign=raw("campaign.yaml"),
        arm=arm_of_campaign,
        poses=result("ingest/poses.parquet"),
        calibration=result(f"calibration/{SETTINGS.evaluation.calibration}.json"),
        code=code_of("commands.discover"),
    output:
        verdict=result("discovery/verdict.json"),
        analysis=result("discovery/analysis.json"),
        extended=result("discovery/extended.json"),
        covariance=result("discovery/extended.covariance.npz"),
        suggested=result("discovery/suggested_poses.csv"),
    log:
        result("logs/discover.log"),
    params:
        folder=campaign_folder,
        settings=settings_of("discovery"),
    shell:
        "python -m pa10cal discover --campaign-dir {params.folder:q} --poses {input.poses:q}"
        " --calibration {input.calibration:q} --settings {params.settings:q}"
        " --verdict {output.verdict:q} --analysis {output.analysis:q} --extended {output.extended:q}"
        " --suggested {output.suggested:q}"
        " 2>&1 | tee {log:q} >&2"

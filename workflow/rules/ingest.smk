rule ingest:
    """Raw logs to a table of poses, and the list of rows that are quarantined."""
    input:
        campaign=raw("campaign.yaml"),
        arm=arm_of_campaign,
        logs=logs_of_campaign,
    output:
        poses=result("ingest/poses.parquet"),
        quarantine=result("ingest/quarantine.csv"),
    log:
        result("logs/ingest.log"),
    params:
        code=code_of("commands.ingest"),
        folder=campaign_folder,
        settings=settings_of("ingest"),
    shell:
        "python -m pa10cal ingest --campaign-dir {params.folder:q} --settings {params.settings:q}"
        " --out {output.poses:q} --quarantine {output.quarantine:q} 2>&1 | tee {log:q} >&2"

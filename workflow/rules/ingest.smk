checkpoint ingest:
    """Raw logs to a table of poses. Which load cases there are is known once this has run."""
    input:
        campaign=raw("campaign.yaml"),
        arm=arm_of_campaign,
        logs=logs_of_campaign,
        code=code_of("commands.ingest"),
    output:
        poses=result("ingest/poses.parquet"),
        quarantine=result("ingest/quarantine.csv"),
    log:
        result("logs/ingest.log"),
    params:
        folder=campaign_folder,
        settings=settings_of("ingest"),
    shell:
        "python -m pa10cal ingest --campaign-dir {params.folder:q} --settings {params.settings:q}"
        " --out {output.poses:q} --quarantine {output.quarantine:q} 2>&1 | tee {log:q} >&2"

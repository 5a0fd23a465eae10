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
    wildcard_constraints:
        campaign=NO_GROUP,
    params:
        code=code_of("stages.readings"),
        folder=campaign_folder,
        settings=settings_of("ingest"),
    shell:
        "python -m pa10cal ingest --campaign-dir {params.folder:q} --settings {params.settings:q}"
        " --out {output.poses:q} --quarantine {output.quarantine:q} 2>&1 | tee {log:q} >&2"


rule join:
    """Campaigns of one robot to one table of poses, with the description of all."""
    input:
        campaigns=members_of(raw("campaign.yaml")),
        arm=arm_of_campaign,
        poses=members_of(result("ingest/poses.parquet")),
        base_frames=members_of(result("seed/base_frame.json")),
    output:
        poses=result("ingest/poses.parquet"),
        quarantine=result("ingest/quarantine.csv"),
        campaign=result("ingest/campaign.yaml"),
    log:
        result("logs/join.log"),
    wildcard_constraints:
        campaign=one_of(GROUPS),
    params:
        code=code_of("stages.readings"),
        folders=members_of(os.path.join(_literal(os.path.normpath(SETTINGS.raw_dir)), "{campaign}")),
        out=campaign_folder,
    shell:
        "python -m pa10cal join --name {wildcards.campaign:q} --campaign-dir {params.folders:q}"
        " --poses {input.poses:q} --base-frame {input.base_frames:q} --out-dir {params.out:q}"
        " 2>&1 | tee {log:q} >&2"

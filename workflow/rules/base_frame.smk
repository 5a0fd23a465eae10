rule base_frame:
    """Base frame in the instrument's frame, from the straight-line moves."""
    input:
        campaign=description_of,
        arm=arm_of_campaign,
        poses=result("ingest/poses.parquet"),
    output:
        result("seed/base_frame.json"),
    log:
        result("logs/base_frame.log"),
    params:
        code=code_of("stages.readings"),
        folder=campaign_folder,
        settings=settings_of("base_frame"),
    shell:
        "python -m pa10cal seed --campaign-dir {params.folder:q} --poses {input.poses:q}"
        " --settings {params.settings:q} --out {output:q} 2>&1 | tee {log:q} >&2"

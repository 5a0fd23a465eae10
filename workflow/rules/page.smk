rule page:
    """The report of a campaign: one page, read from top to bottom."""
    input:
        campaign=description_of,
        poses=result("ingest/poses.parquet"),
        base_frame=result("seed/base_frame.json"),
        calibration=result("calibration/combined.json"),
        # all of these stages, so that each that was removed is made again
        discovered=list(WRITES["discover"].values()),
        evaluated=list(WRITES["evaluate"].values()),
        exported=list(WRITES["export"].values()),
        pictures=result("pictures.json"),
    output:
        result("report.html"),
    log:
        result("logs/page.log"),
    wildcard_constraints:
        campaign=NO_STUDY,
    params:
        calibration=SETTINGS.evaluation.calibration,
        code=code_of("pa10cal.commands.runs"),
        folder=campaign_folder,
        results=results_folder,
    shell:
        "python -m pa10cal report {params.results:q} --campaign-dir {params.folder:q}"
        " --calibration {params.calibration:q} --out {output:q} 2>&1 | tee {log:q} >&2"

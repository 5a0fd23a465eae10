rule transfer:
    """A model calibrated in one campaign judged in another: only base and tool are found anew."""
    input:
        campaign=raw("campaign.yaml"),
        arm=arm_of_campaign,
        poses=result("ingest/poses.parquet"),
        calibration=lambda wildcards: expand(rules.calibrate.output, campaign=wildcards.source)[0],
        extended=lambda wildcards: expand(
            result("discovery/extended.json"), campaign=wildcards.source
        ),
    output:
        result("evaluation/transfer_{source}.json"),
    log:
        result("logs/transfer_{source}.log"),
    # Those of the plan: results of others are not to be made by it.
    wildcard_constraints:
        source=one_of([*EVERY, *UR10, *IMPORTED_GROUPS]),
    params:
        code=code_of("pa10cal.stages.evaluate"),
        folder=campaign_folder,
    shell:
        "python -m pa10cal transfer --calibration {input.calibration:q} --extended {input.extended:q}"
        " --campaign-dir {params.folder:q} --poses {input.poses:q} --out {output:q}"
        " 2>&1 | tee {log:q} >&2"


rule ur10:
    """The UR10 that was really measured, from the public data to figures: each series, both as one
    robot, and each model judged in the other series."""
    input:
        expand(
            [
                *rules.discover.output[:1],
                *rules.export.output[:1],
                *rules.evaluate.output[:1],
                result("pictures.json"),
                result("report.html"),
            ],
            campaign=[*UR10, *IMPORTED_GROUPS],
        ),
        [
            expand(result("evaluation/transfer_{source}.json"), campaign=target, source=source)
            for target in UR10
            for source in UR10
            if source != target
        ],

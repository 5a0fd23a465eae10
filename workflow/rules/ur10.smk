rule transfer:
    """A model calibrated in one campaign judged in another: only base and tool are found anew."""
    input:
        campaign=raw("campaign.yaml"),
        arm=arm_of_campaign,
        poses=result("ingest/poses.parquet"),
        calibration=lambda wildcards: expand(result("calibration"), campaign=wildcards.source)[0],
        extended=lambda wildcards: expand(
            result("discovery/extended.json"), campaign=wildcards.source
        ),
    output:
        result("evaluation/transfer_{source}.json"),
    log:
        result("logs/transfer_{source}.log"),
    params:
        calibration=lambda wildcards, input: os.path.join(input.calibration, "combined.json"),
        code=code_of("commands.transfer"),
        folder=campaign_folder,
    shell:
        "python -m pa10cal transfer --calibration {params.calibration:q} --extended {input.extended:q}"
        " --campaign-dir {params.folder:q} --poses {input.poses:q} --out {output:q}"
        " 2>&1 | tee {log:q} >&2"


rule ur10:
    """The UR10 that was really measured, from the public data to figures."""
    input:
        lambda wildcards: [
            path
            for campaign in UR10
            for path in (
                *expand(rules.discover.output.verdict, campaign=campaign),
                *expand(rules.export.output.model, campaign=campaign),
                *expand(result("pictures.json"), campaign=campaign),
            )
        ],
        expand(result("evaluation/transfer_{source}.json"), campaign="ur10-c", source="ur10-a"),

# Many campaigns: each from raw files to its model in one process, then one summary of all. A
# campaign that is refused is in the summary with its message: its job has not failed where there is
# a `chain.json`. Figures and reports are made for those that are asked for, by the rules of the
# single stages.
FLEET_FILES = [
    os.path.join(_literal(SETTINGS.results_dir), "fleet", f"fleet.{end}")
    for end in ("csv", "html", "json")
]


rule chain:
    """One campaign of many from raw files to its model, in one process."""
    input:
        campaign_if_there,
    output:
        result("chain.json"),
    log:
        result("logs/chain.log"),
    params:
        code=code_of("pa10cal.commands.chain"),
        folder=campaign_folder,
        results=results_folder,
        prior=PRIOR,
        settings=sections_of("ingest", "base_frame", "calibration", "evaluation", "discovery"),
    shell:
        "python -m pa10cal chain --campaign-dir {params.folder:q} --results {params.results:q}"
        " --settings {params.settings:q} > {log:q} 2>&1 || test -e {output:q}"


rule fleet:
    """Every campaign of a fleet, and how its arms stand."""
    input:
        expand(rules.chain.output, campaign=SETTINGS.campaigns),
    output:
        FLEET_FILES,
    log:
        os.path.join(_literal(SETTINGS.results_dir), "fleet", "fleet.log"),
    params:
        code=code_of("pa10cal.commands.fleet"),
        campaigns=FLEET if isinstance(FLEET, str) else ",".join(SETTINGS.campaigns),
        out=lambda wildcards, output: os.path.dirname(output[0]),
        raw=SETTINGS.raw_dir,
        results=lambda wildcards, output: os.path.dirname(os.path.dirname(output[0])),
    shell:
        "python -m pa10cal fleet_summary --campaigns {params.campaigns:q} --raw-dir {params.raw:q}"
        " --results {params.results:q} --out {params.out:q} 2>&1 | tee {log:q} >&2"

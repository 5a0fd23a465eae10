# Beside the results, never over the raw data: those are only read.
SIMULATED = os.path.join(_literal(SETTINGS.results_dir), "simulated", "{name}")
TOUCHED = [name for name, section in SETTINGS.simulate.items() if section.without_touches is None]
TRACKED = [name for name in SETTINGS.simulate if name not in TOUCHED]


rule simulate:
    """Every campaign that the configuration describes for the virtual cell."""
    input:
        expand(f"{SIMULATED}/campaign.yaml", name=SETTINGS.simulate),


rule simulate_campaign:
    """One campaign of the virtual cell, and apart from it the truth that no estimate may read."""
    output:
        campaign=f"{SIMULATED}/campaign.yaml",
        cmm=f"{SIMULATED}/cmm.csv.gz",
        resolver=f"{SIMULATED}/resolver.csv.gz",
        truth=f"{SIMULATED}.truth.json",
    log:
        f"{SIMULATED}.log",
    wildcard_constraints:
        name=one_of(TOUCHED),
    params:
        code=code_of("pa10cal_lab.command_simulate"),
        folder=lambda wildcards, output: os.path.dirname(output.campaign),
        kcub_reading=SETTINGS.kcub_reading,
        settings=lambda wildcards: SETTINGS.simulate[wildcards.name].model_dump_json(),
    shell:
        "python -m pa10cal simulate --name {wildcards.name:q} --settings {params.settings:q}"
        " --kcub-reading {params.kcub_reading} --out {params.folder:q} --truth {output.truth:q}"
        " 2>&1 | tee {log:q} >&2"


rule simulate_tracked:
    """One campaign of any arm under an instrument that does not touch, and its truth apart."""
    output:
        campaign=f"{SIMULATED}/campaign.yaml",
        poses=f"{SIMULATED}/poses.csv",
        truth=f"{SIMULATED}.truth.json",
    log:
        f"{SIMULATED}.log",
    wildcard_constraints:
        name=one_of(TRACKED),
    params:
        code=code_of("pa10cal_lab.command_simulate"),
        folder=lambda wildcards, output: os.path.dirname(output.campaign),
        settings=lambda wildcards: SETTINGS.simulate[wildcards.name].model_dump_json(),
    shell:
        "python -m pa10cal simulate --name {wildcards.name:q} --settings {params.settings:q}"
        " --out {params.folder:q} --truth {output.truth:q} 2>&1 | tee {log:q} >&2"

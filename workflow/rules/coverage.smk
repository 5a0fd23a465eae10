rule coverage:
    """Long test: do 95 % intervals hold the truth of simulated campaigns in 95 % of cases?"""
    input:
        code=code_of("stages.coverage"),
    output:
        os.path.join(_literal(SETTINGS.results_dir), "coverage.json"),
    log:
        os.path.join(_literal(SETTINGS.results_dir), "logs", "coverage.log"),
    params:
        settings=settings_of("calibration"),
    shell:
        "python -m pa10cal coverage --campaigns 50 --settings {params.settings:q} --out {output:q}"
        " 2>&1 | tee {log:q} >&2"

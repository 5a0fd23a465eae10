rule coverage:
    """Long test: do 95 % intervals hold the truth of simulated campaigns in 95 % of cases?"""
    input:
        coverage_result("coverage.json"),
        coverage_result("coverage_general.json"),


rule coverage_papers_model:
    """The paper's robot, touched, calibrated with the paper's model."""
    input:
        code=code_of("commands.coverage"),
    output:
        coverage_result("coverage.json"),
    log:
        coverage_result("logs/coverage.log"),
    params:
        campaigns=SETTINGS.coverage.campaigns,
        seed=SETTINGS.coverage.random_seed,
        settings=settings_of("calibration"),
    shell:
        "python -m pa10cal coverage --campaigns {params.campaigns} --first-seed {params.seed}"
        " --settings {params.settings:q} --out {output:q} 2>&1 | tee {log:q} >&2"


rule coverage_general_model:
    """Other arms under other instruments, calibrated with the general model."""
    input:
        code=code_of("commands.coverage_general"),
    output:
        record=coverage_result("coverage_general.json"),
        table=coverage_result("coverage_general.csv"),
    log:
        coverage_result("logs/coverage_general.log"),
    params:
        settings=settings_of("coverage", without=("campaigns",)),
        calibration=settings_of("calibration"),
    shell:
        "python -m pa10cal coverage_general --settings {params.settings:q}"
        " --calibration {params.calibration:q} --out {output.record:q} --table {output.table:q}"
        " 2>&1 | tee {log:q} >&2"

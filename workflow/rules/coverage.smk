rule coverage:
    """Long test: do 95 % intervals hold the truth of simulated campaigns in 95 % of cases?"""
    output:
        record=coverage_result("coverage.json"),
        table=coverage_result("coverage.csv"),
    log:
        coverage_result("logs/coverage.log"),
    params:
        code=code_of("pa10cal_lab.command_studies"),
        settings=settings_of("coverage"),
        calibration=settings_of("calibration"),
    shell:
        "python -m pa10cal coverage --settings {params.settings:q}"
        " --calibration {params.calibration:q} --out {output.record:q} --table {output.table:q}"
        " 2>&1 | tee {log:q} >&2"

rule evaluate:
    """Uncalibrated, linear and cubic models on the held-out points and loads."""
    input:
        **READS["evaluate"],
        campaign=description_of,
        arm=arm_of_campaign,
    output:
        **WRITES["evaluate"],
    log:
        result("logs/evaluate.log"),
    params:
        code=code_of("pa10cal.stages.evaluate"),
        words=words_of("evaluate"),
    shell:
        "python -m pa10cal {params.words} 2>&1 | tee {log:q} >&2"

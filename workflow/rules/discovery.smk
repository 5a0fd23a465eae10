rule discover:
    """Where model and data disagree, which effect is missing, and the gap with it closed."""
    input:
        **READS["discover"],
        campaign=description_of,
        arm=arm_of_campaign,
    output:
        **WRITES["discover"],
    log:
        result("logs/discover.log"),
    priority: PRIORITY["discover"]
    params:
        code=code_of("pa10cal.stages.discover"),
        words=words_of("discover"),
    shell:
        "python -m pa10cal {params.words} 2>&1 | tee {log:q} >&2"

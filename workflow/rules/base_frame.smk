rule base_frame:
    """Base frame in the instrument's frame, from the straight-line moves."""
    input:
        **READS["seed"],
        campaign=description_of,
        arm=arm_of_campaign,
    output:
        **WRITES["seed"],
    log:
        result("logs/base_frame.log"),
    wildcard_constraints:
        campaign=rf"[^/]+|{MEMBER}",
    priority: PRIORITY["base_frame"]
    params:
        code=code_of("pa10cal.stages.readings"),
        words=words_of("seed"),
    shell:
        "python -m pa10cal {params.words} 2>&1 | tee {log:q} >&2"

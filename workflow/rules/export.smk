rule export:
    """The calibrated model for other programs: all parameters, and the geometry as URDF."""
    input:
        **READS["export"],
        campaign=description_of,
        arm=arm_of_campaign,
    output:
        **WRITES["export"],
    log:
        result("logs/export.log"),
    params:
        code=code_of("pa10cal.stages.export"),
        words=words_of("export"),
    shell:
        "python -m pa10cal {params.words} 2>&1 | tee {log:q} >&2"

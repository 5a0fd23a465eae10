rule calibrate:
    """Every load of a campaign, all loads together, and the general model beside the paper's.

    The other load cases lie beside the one of all loads, which is there of every campaign.
    """
    input:
        **READS["calibrate"],
        campaign=description_of,
        arm=arm_of_campaign,
    output:
        **WRITES["calibrate"],
    log:
        result("logs/calibrate.log"),
    priority: PRIORITY["calibrate"]
    params:
        code=code_of("pa10cal.stages.calibrate"),
        words=words_of("calibrate"),
        prior=PRIOR,
    shell:
        "python -m pa10cal {params.words} 2>&1 | tee {log:q} >&2"


use rule calibrate as calibrate_one with:
    output:
        calibration=result("calibration/{load}.json"),
    log:
        result("logs/calibrate_{load}.log"),
    wildcard_constraints:
        load=r"(?!combined\.json$)[^/]+",


if "baseline" in STAGES:

    # Where effects are those of the verdict, the search starts from a calibration without them.
    use rule calibrate as calibrate_baseline with:
        input:
            **READS["baseline"],
            campaign=description_of,
            arm=arm_of_campaign,
        output:
            **WRITES["baseline"],
        log:
            result("logs/calibrate_baseline.log"),
        params:
            code=code_of("pa10cal.stages.calibrate"),
            words=words_of("baseline"),
            prior=PRIOR,

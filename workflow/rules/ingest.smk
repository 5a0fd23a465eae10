rule ingest:
    """Raw logs to a table of poses, and the list of rows that are quarantined."""
    input:
        campaign=description_of,
        arm=arm_of_campaign,
        logs=logs_of_campaign,
    output:
        **WRITES["ingest"],
    log:
        result("logs/ingest.log"),
    wildcard_constraints:
        campaign=f"{NO_GROUP}|{MEMBER}",
    priority: PRIORITY["ingest"]
    params:
        code=code_of("pa10cal.stages.readings"),
        words=words_of("ingest"),
    shell:
        "python -m pa10cal {params.words} 2>&1 | tee {log:q} >&2"


rule join:
    """Campaigns of one robot to one table of poses, with the description of all."""
    input:
        campaigns=members_of(raw("campaign.yaml"), ""),
        arm=arm_of_campaign,
        poses=members_of(WRITES["ingest"]["poses"]),
        base_frames=members_of(WRITES["seed"]["base_frame"]),
    output:
        **WRITES["join"],
    log:
        result("logs/join.log"),
    wildcard_constraints:
        campaign=one_of(GROUPS),
    priority: PRIORITY["join"]
    params:
        code=code_of("pa10cal.stages.readings"),
        words=words_of("join"),
    shell:
        "python -m pa10cal {params.words} 2>&1 | tee {log:q} >&2"

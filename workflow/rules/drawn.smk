"""What pictures are drawn from."""


def found_of(*names):
    """The function that names results of a campaign."""
    return lambda campaign: expand(result("{name}"), campaign=campaign, name=names)


# The files behind what modules call their needs; what is left out is a property of the campaign.
NEEDS = {
    **dict.fromkeys(
        ("papers_calibration", "general"),
        found_of("calibration/combined.json"),
    ),
    "poses": found_of("ingest/poses.parquet"),
    "base_frame": found_of("seed/base_frame.json"),
    "planes": planes_of,
    **dict.fromkeys(
        ("evaluation", "held_out"),
        found_of("calibration/combined.json", "evaluation/holdout.json", "discovery/verdict.json"),
    ),
    # The verdict says whether effects were sought, and the calibration whether it converged.
    "analysis": found_of(
        "calibration/combined.json", "discovery/analysis.json", "discovery/verdict.json"
    ),
    "verdict": found_of("calibration/combined.json", "discovery/verdict.json"),
}


def results_of_campaign(wildcards):
    """All results of a campaign that pictures are drawn from."""
    return sorted({path for need in NEEDS.values() for path in need(wildcards.campaign)})


def results_needed(wildcards):
    """Those that one picture is drawn from."""
    from pa10cal.figures.registry import entries  # late: planning the others loads no picture

    found = entries("campaign").get(wildcards.picture)
    names = [name for name in found.needs if name in NEEDS] if found else []
    return sorted({path for name in names for path in NEEDS[name](wildcards.campaign)})

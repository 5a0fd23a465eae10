"""What pictures are drawn from."""

from pa10cal.figures.registry import NEEDS


def files_of_need(need, campaign):
    """The files behind what modules call their needs; what is left out is a property of the campaign."""
    if need == "planes":
        return planes_of(campaign)
    return expand(result("{name}"), campaign=campaign, name=NEEDS.get(need, ()))


def results_of_campaign(wildcards):
    """All results of a campaign that pictures are drawn from."""
    return sorted({path for need in NEEDS for path in files_of_need(need, wildcards.campaign)})


def results_needed(wildcards):
    """Those that one picture is drawn from."""
    from pa10cal.figures.registry import entries  # late: planning the others loads no picture

    found = entries("campaign").get(wildcards.picture)
    needs = found.needs if found else ()
    return sorted({path for need in needs for path in files_of_need(need, wildcards.campaign)})

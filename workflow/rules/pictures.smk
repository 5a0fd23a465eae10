# The pictures of a campaign, drawn in one process. Modules of pa10cal.figures say which there are; one
# that has nothing to show is omitted, and pictures.json says why.
from pa10cal.figures.report import Captions, titles


def found_of(*names):
    """The function that names results of a campaign."""
    return lambda campaign: expand(result("{name}"), campaign=campaign, name=names)


def discovered(name):
    """A result of discovery, where effects are sought."""
    return lambda campaign: found_of("calibration", f"discovery/{name}.json")(campaign)[
        : 2 * seeks_effects(campaign)
    ]


# The files behind what modules call their needs; what is left out is a property of the campaign.
NEEDS = {
    **dict.fromkeys(
        ("calibration", "papers_calibration", "general_calibration", "general"),
        found_of("calibration"),
    ),
    "poses": found_of("ingest/poses.parquet"),
    "base_frame": found_of("seed/base_frame.json"),
    "planes": planes_of,
    **dict.fromkeys(("evaluation", "held_out"), found_of("calibration", "evaluation/holdout.json")),
    "analysis": discovered("analysis"),
    "verdict": discovered("verdict"),
    "gap": lambda campaign: [*discovered("analysis")(campaign), *found_of("calibration")(campaign)],
}


def results_of_campaign(wildcards):
    """All results of a campaign that pictures are drawn from."""
    return sorted({path for need in NEEDS.values() for path in need(wildcards.campaign)})


def results_needed(wildcards):
    """Those that one picture is drawn from."""
    from pa10cal.figures.registry import entries  # late: planning the others loads no picture

    found = entries("campaign").get(wildcards.picture)
    names = [name for name in found.picture.needs if name in NEEDS] if found else []
    return sorted({path for name in names for path in NEEDS[name](wildcards.campaign)})


def reported(path, folder, pattern, **where):
    """Mark a folder of pictures for the report."""
    return report(
        directory(path),
        patterns=[pattern],
        caption="../report/picture.rst",
        labels=titles(folder),
        **where,
    )


DRAW = (
    "python -m pa10cal figures --results {params.results:q} --campaign-dir {params.folder:q}"
    " --settings {params.settings:q}"
)
DRAWN_WITH = sections_of("figures", "kcub_reading", "montecarlo", "evaluation")


rule figures:
    """Every figure and table of every campaign."""
    input:
        expand(result("pictures.json"), campaign=SETTINGS.campaigns),


rule pictures:
    """The figures and tables of a campaign that have something to show."""
    input:
        campaign=raw("campaign.yaml"),
        arm=arm_of_campaign,
        results=results_of_campaign,
    output:
        index=result("pictures.json"),
        figures=reported(result("figures"), "campaign", "{picture}.svg", category="{campaign}"),
        tables=reported(result("tables"), "campaign", "{picture}.html", category="{campaign}"),
    log:
        result("logs/pictures.log"),
    wildcard_constraints:
        campaign=NO_STUDY,
    params:
        code=code_of("commands.figures", "figures.registry"),
        captions=Captions("campaign", "campaign"),
        folder=campaign_folder,
        results=results_folder,
        settings=DRAWN_WITH,
    shell:
        DRAW + " 2>&1 | tee {log:q} >&2"


for kind, endings in {"figures": ["svg", "pdf", "png"], "tables": ["csv", "md", "html"]}.items():

    rule:
        name:
            f"one_of_the_{kind}"
        input:
            campaign=raw("campaign.yaml"),
            arm=arm_of_campaign,
            results=results_needed,
        output:
            [result(f"{kind}/{{picture}}.{ending}") for ending in endings],
        log:
            result(f"logs/{kind}_{{picture}}.log"),
        wildcard_constraints:
            campaign=NO_STUDY,
            picture="[a-z0-9_]+",
        params:
            code=code_of("commands.figures", "figures.registry"),
            folder=campaign_folder,
            results=results_folder,
            settings=DRAWN_WITH,
        shell:
            DRAW + " --figure {wildcards.picture} 2>&1 | tee {log:q} >&2"

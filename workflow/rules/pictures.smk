# The pictures of a campaign, drawn in one process. Modules of pa10cal.figures say which there are; one
# that has nothing to show is omitted, and pictures.json says why.
DRAWN_WITH = sections_of("figures", "kcub_reading", "montecarlo", "evaluation")


rule figures:
    """Every figure and table of every campaign."""
    input:
        expand(result("pictures.json"), campaign=EVERY),


rule pictures:
    """The figures and tables of a campaign that have something to show."""
    input:
        campaign=description_of,
        arm=arm_of_campaign,
        results=results_of_campaign,
    output:
        index=result("pictures.json"),
        figures=directory(result("figures")),
        tables=directory(result("tables")),
    log:
        result("logs/pictures.log"),
    wildcard_constraints:
        campaign=NO_STUDY,
    params:
        code=code_of("pa10cal.commands.figures", "pa10cal.figures.registry"),
        folder=campaign_folder,
        results=results_folder,
        settings=DRAWN_WITH,
    shell:
        "python -m pa10cal figures --results {params.results:q} --campaign-dir {params.folder:q}"
        " --settings {params.settings:q} --force 2>&1 | tee {log:q} >&2"


for kind, endings in {"figures": ["svg", "pdf", "png"], "tables": ["csv", "md"]}.items():

    rule:
        name:
            f"one_of_the_{kind}"
        input:
            campaign=description_of,
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
            code=code_of("pa10cal.commands.figures", "pa10cal.figures.registry"),
            folder=campaign_folder,
            results=results_folder,
            settings=DRAWN_WITH,
        shell:
            "python -m pa10cal figures --results {params.results:q} --campaign-dir {params.folder:q}"
            " --settings {params.settings:q} --figure {wildcards.picture} --force 2>&1 | tee {log:q} >&2"

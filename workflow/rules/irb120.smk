# An IRB 120 with three reflectors under a laser tracker that watches the base: the measured one where
# `dataset_sources` says where it is, else one made up in its layout, which says that it is synthetic.
IRB120_SOURCE = SETTINGS.dataset_sources.get("faro-irb120", "")
IRB120_TABLES = os.path.join(_literal(SETTINGS.results_dir), "datasets", "faro-irb120")


rule made_up_irb120:
    """A synthetic campaign in the layout of the tables, and what is hidden in it apart."""
    output:
        joints=f"{IRB120_TABLES}/joints.txt",
        truth=f"{IRB120_TABLES}.truth.json",
    log:
        f"{IRB120_TABLES}.log",
    params:
        code=code_of("commands.made_up_irb120"),
        folder=lambda wildcards, output: os.path.dirname(output.joints),
    shell:
        "python -m pa10cal made_up_irb120 --out {params.folder:q} --truth {output.truth:q}"
        " 2>&1 | tee {log:q} >&2"


rule import_faro_irb120:
    """The campaign irb120, of the tables."""
    input:
        os.path.join(IRB120_SOURCE, "joints.txt") if IRB120_SOURCE else rules.made_up_irb120.output,
    output:
        [
            os.path.join(_literal(SETTINGS.raw_dir), "irb120", name)
            for name in ("campaign.yaml", IMPORTED.get("irb120", "poses.csv.gz"), "left_out.csv")
        ],
    log:
        f"{IRB120_TABLES}.import.log",
    params:
        code=code_of("commands.import_data", "datasets.readers.faro_irb120"),
        folder=lambda wildcards, input: os.path.dirname(input[0]),
        out=lambda wildcards, output: os.path.dirname(os.path.dirname(output[0])),
        settings=settings_of("ingest"),
    shell:
        "python -m pa10cal import faro-irb120 {params.folder:q} --out {params.out:q}"
        " --settings {params.settings:q} 2>&1 | tee {log:q} >&2"


rule irb120:
    """The IRB 120 from its tables to verdict, model, figures and the page of the campaign."""
    input:
        expand(rules.discover.output.verdict, campaign="irb120"),
        expand(rules.export.output.model, campaign="irb120"),
        expand(rules.evaluate.output, campaign="irb120"),
        expand(result("pictures.json"), campaign="irb120"),
        expand(rules.page.output, campaign="irb120"),

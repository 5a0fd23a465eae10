# Campaigns made of public data sets. They are written into the folder of campaigns, where all other
# rules find them, and only there.
from pa10cal.datasets.readers import dataset_names

for name in SETTINGS.dataset_sources:
    if name not in dataset_names():
        refuse(
            f"config.yaml or --config: dataset_sources: there is no data set {name!r};"
            f" allowed: {', '.join(dataset_names())}; correct the name"
        )


FETCHED = os.path.join(_literal(SETTINGS.results_dir), "datasets", "ipa-robot-accuracy")


rule fetch_ipa_robot_accuracy:
    """The UR10 data set, of the pinned version and checked: fetched, or copied from a folder.

    No code is an input: checksums say what the files are, and editing it must not fetch them again.
    """
    output:
        licence=f"{FETCHED}/LICENSE.md",
        series_a=f"{FETCHED}/Series_A/measurements_grid.csv",
        series_c=f"{FETCHED}/Series_C/measurements_random_poses.csv",
    log:
        f"{FETCHED}.fetch.log",
    params:
        folder=lambda wildcards, output: os.path.dirname(output.licence),
        source=lambda wildcards: source_option("ipa-robot-accuracy"),
    shell:
        "python -m pa10cal fetch ipa-robot-accuracy --out {params.folder:q}"
        " {params.source} 2>&1 | tee {log:q} >&2"


rule import_ipa_robot_accuracy:
    """The campaigns ur10-a and ur10-c."""
    input:
        rules.fetch_ipa_robot_accuracy.output,
    output:
        [
            os.path.join(_literal(SETTINGS.raw_dir), campaign, name)
            for campaign, readings in IMPORTED.items()
            for name in ("campaign.yaml", readings, "left_out.csv")
        ],
    log:
        f"{FETCHED}.import.log",
    params:
        code=code_of("pa10cal.commands.data", "pa10cal.datasets.readers"),
        folder=lambda wildcards, input: os.path.dirname(input[0]),
        out=lambda wildcards, output: os.path.dirname(os.path.dirname(output[0])),
        settings=settings_of("ingest"),
    shell:
        "python -m pa10cal import ipa-robot-accuracy {params.folder:q} --out {params.out:q}"
        " --settings {params.settings:q} 2>&1 | tee {log:q} >&2"

# Campaigns of real robots that are at hand: folders of `measured_dir`, and public data sets that were
# fetched into it. Each goes from its files to its model in one process, so that one that is refused is
# in the table with its message, and its job has not failed; their results lie apart from those of the
# configured campaigns.
from pa10cal.datasets.known_campaigns import at_hand, files_of, groups_of

try:
    MEASURED = at_hand(
        Path(SETTINGS.measured_dir),
        SETTINGS.dataset_sources,
        Path(SETTINGS.results_dir, "datasets", "raw"),
    )
except Pa10calError as error:
    refuse(error)
MEASURED_GROUPS = groups_of(MEASURED)


rule measured_campaign:
    """One measured campaign from its files, or those of its data set, to its model."""
    input:
        lambda wildcards: files_of(MEASURED[wildcards.measured]),
        # of the campaign's own arm, which may lie in a folder beside it
        lambda wildcards: arm_files(MEASURED[wildcards.measured].folder),
    output:
        measured_result("{measured}/chain.json"),
    log:
        measured_result("{measured}/logs/chain.log"),
    wildcard_constraints:
        measured=one_of(MEASURED),
    params:
        code=code_of("pa10cal.commands.chain", "pa10cal.datasets.readers"),
        folder=lambda wildcards: MEASURED[wildcards.measured].folder,
        imported=lambda wildcards: import_option(MEASURED[wildcards.measured]),
        results=lambda wildcards, output: os.path.dirname(output[0]),
        prior=PRIOR,
        settings=sections_of("ingest", "base_frame", "calibration", "evaluation", "discovery"),
    shell:
        "python -m pa10cal chain --campaign-dir {params.folder:q} {params.imported}"
        " --results {params.results:q} --settings {params.settings:q} > {log:q} 2>&1"
        " || test -e {output:q}"


rule measured_group:
    """Several measured campaigns of one robot as one."""
    input:
        lambda wildcards: expand(
            rules.measured_campaign.output, measured=MEASURED_GROUPS[wildcards.measured]
        ),
    output:
        measured_result("{measured}/chain.json"),
    log:
        measured_result("{measured}/logs/chain.log"),
    wildcard_constraints:
        measured=one_of(MEASURED_GROUPS),
    params:
        code=code_of("pa10cal.commands.chain"),
        folders=lambda wildcards: [
            MEASURED[member].folder for member in MEASURED_GROUPS[wildcards.measured]
        ],
        results=lambda wildcards, output: os.path.dirname(output[0]),
        prior=PRIOR,
        settings=sections_of("ingest", "base_frame", "calibration", "evaluation", "discovery"),
    shell:
        "python -m pa10cal chain --campaign-dir {params.folders:q} --results {params.results:q}"
        " --settings {params.settings:q} > {log:q} 2>&1 || test -e {output:q}"


rule measured:
    """Every measured campaign at hand in one table, with models carried from one to another."""
    input:
        expand(rules.measured_campaign.output, measured=MEASURED),
        expand(rules.measured_group.output, measured=MEASURED_GROUPS),
    output:
        table=measured_result("measured.csv"),
        record=measured_result("measured.json"),
    log:
        measured_result("measured.log"),
    params:
        calibration=SETTINGS.evaluation.calibration,
        code=code_of("pa10cal.commands.fleet"),
        folders=folders_option(each.folder for each in MEASURED.values()),
        out=lambda wildcards, output: os.path.dirname(output.record),
    shell:
        "python -m pa10cal measured {params.folders} --results {params.out:q} --out {params.out:q}"
        " --calibration {params.calibration:q} 2>&1 | tee {log:q} >&2"

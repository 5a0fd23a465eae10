"""What the rules share: settings, paths, and the functions that give inputs and parameters."""

import os
import re
import shlex
import sys
from pathlib import Path

from pa10cal.errors import Pa10calError, SettingsError
from pa10cal.command_settings import ChainOptions
from pa10cal.fleet.campaigns import campaigns_of
from pa10cal.planning.campaign import (
    arm_files,
    campaign_name,
    check_prior,
    group_like_campaign,
    instrument_kind,
    missing_campaign,
    prior_digest,
    raw_files,
    robot_name,
    by_general_model as planned_by_general_model,
)
from pa10cal.planning.code import code_digest
from pa10cal.running.child import PARENTS, end_with_parents
from pa10cal.running.run_lock import hold
from pa10cal.settings import parse_settings
from pa10cal.stages.pipeline import MEMBERS, stages
from pa10cal_lab import options


def refuse(error):
    """Stop with one line and the exit code of a refusal; an exception would bring Snakemake's own."""
    print(f"pa10cal: {error}", file=sys.stderr)
    sys.exit(2)


# What stands in a table or fits a pattern is looked for when it is worked on: one campaign of many
# that is not there stops no other.
FLEET = config.get("campaigns")
try:
    if isinstance(FLEET, str):
        listed = campaigns_of(FLEET, Path(config.get("raw_dir", "data/raw")))
        config["campaigns"] = [each.campaign for each in listed]
    SETTINGS = parse_settings(config, where="config.yaml or --config")
except SettingsError as error:
    refuse(error)
# The import leaves a list of what it left out: a campaign of that name without one is the user's own,
# and nothing is fetched over it.
IMPORTED = {
    name: readings
    for name, readings in IMPORTED.items()
    if not Path(SETTINGS.raw_dir, name, "campaign.yaml").is_file()
    or Path(SETTINGS.raw_dir, name, "left_out.csv").is_file()
}
IN_GROUPS = tuple(name for each in SETTINGS.groups.values() for name in each)
for campaign in (*(() if isinstance(FLEET, str) else SETTINGS.campaigns), *IN_GROUPS):
    if campaign in IMPORTED:
        continue
    if not Path(SETTINGS.raw_dir, campaign, "campaign.yaml").is_file():
        refuse(missing_campaign(SETTINGS.raw_dir, campaign))

# Results of another campaign, as a prior is, are no input of a rule: they would be made anew, with
# the settings of this run. They are read as they are, and what they contain is a parameter.
PRIOR = prior_digest(SETTINGS.calibration.prior)
if SETTINGS.calibration.prior:
    try:
        own = {*SETTINGS.campaigns, *SETTINGS.groups, *IN_GROUPS}
        check_prior(SETTINGS.calibration.prior, [Path(SETTINGS.results_dir, name) for name in own])
    except Pa10calError as error:
        refuse(error)

# Setting a prefix drops Snakemake's own, so the first part repeats it. The second lets the rules say
# `python` whether or not the environment of Snakemake is activated. With the last a job ends when
# Snakemake or its shell does.
shell.prefix(
    f'set -euo pipefail; export PATH={shlex.quote(str(Path(sys.executable).parent))}:"$PATH"; '
    f'export {PARENTS}="{os.getpid()} $$"; '
)

# What a search waits for goes before all else, and a search before what is made of another: it is the
# longest job by far, and that of a group the longest of all.
PRIORITY = {"ingest": 3, "base_frame": 3, "join": 3, "calibrate": 2, "discover": 1}

for group in SETTINGS.groups:
    if Path(SETTINGS.raw_dir, group, "campaign.yaml").is_file():
        refuse(group_like_campaign(SETTINGS.raw_dir, group))
# Campaigns and groups, whose results have the same names.
EVERY = (*SETTINGS.campaigns, *SETTINGS.groups)
# Those of the public data sets too, but where a campaign has the name.
GROUPS = {
    name: members
    for name, members in {**IMPORTED_GROUPS, **SETTINGS.groups}.items()
    if name not in SETTINGS.campaigns and not Path(SETTINGS.raw_dir, name).exists()
}

if workflow.is_main_process:
    end_with_parents()


# Snakemake's own lock, of the working folder, stays when it is killed; profiles and commands do without.
onstart:
    jobs = list(workflow.dag.needrun_jobs())
    try:
        hold(
            Path(SETTINGS.results_dir),
            [path for job in jobs for path in (*job.output, *job.log)],
        )
    except Pa10calError as error:
        refuse(error)


wildcard_constraints:
    campaign=r"[^/]+",
    load=r"[0-9.e+-]+N|combined|general",


# Studies of blind trials: what measures, and how many of each kind. The first of the full one are
# part of the default target.
TRIAL_STUDIES = {
    study: (measured, dict(getattr(SETTINGS.blind_trials, counts)))
    for study, (measured, counts) in options.TRIAL_STUDIES.items()
}
# The same of instruments that measure no attitude.
REFLECTOR_STUDIES = [
    study for study, (_, counts) in options.TRIAL_STUDIES.items() if counts == "reflectors"
]
# Of the first, those alone that hide what no name covers.
OUTSIDE_STUDIES = {
    study: (TRIAL_STUDIES[whole][0], {kind: TRIAL_STUDIES[whole][1][kind]})
    for study, (whole, kind) in options.OUTSIDE_STUDIES.items()
}
TRIAL_STUDIES |= OUTSIDE_STUDIES


def one_of(names):
    """Pattern of a wildcard that stands for one of the names; of none where there are none."""
    return "|".join(map(re.escape, names)) or "(?!)"


# Those whose raw files are read, and not joined of others; what a group reads of its members lies
# among its own results, so that it changes none of theirs.
NO_GROUP = rf"(?!(?:{one_of(GROUPS)})(?:/|$))[^/]+"
MEMBER = rf"(?:{one_of(GROUPS)})/{MEMBERS}/[^/]+"


# What campaigns are not called: the folders of studies stand beside theirs.
NO_STUDY = rf"(?!(?:curve|{'|'.join(TRIAL_STUDIES)})(?:/|$))[^/]+"


def raw(name):
    """The path pattern of a raw file of a campaign."""
    return os.path.join(_literal(SETTINGS.raw_dir), "{campaign}", name)


def result(name):
    """The path pattern of a result of a campaign."""
    return os.path.join(_literal(SETTINGS.results_dir), "{campaign}", name)


def description_of(wildcards):
    """The description of a campaign; of a group the one that is joined of those of its campaigns."""
    if wildcards.campaign in GROUPS:
        return result("ingest/campaign.yaml").format(campaign=wildcards.campaign)
    return raw("campaign.yaml").format(campaign=campaign_of(wildcards))


def campaign_of(wildcards):
    """The campaign itself where it is a member of a group."""
    return wildcards.campaign.rpartition("/")[2]


def members_of(pattern, folder=f"{{group}}/{MEMBERS}/"):
    """The function that gives a file of every campaign of a group, by default of what the group reads."""
    return lambda wildcards: [
        pattern.format(campaign=folder.format(group=wildcards.campaign) + campaign)
        for campaign in GROUPS[wildcards.campaign]
    ]


def _literal(path):
    return os.path.normpath(path).replace("{", "{{").replace("}", "}}")


CHAIN = ChainOptions(**{name: getattr(SETTINGS, name) for name in ChainOptions.model_fields})


def stages_of(folders, results, load=None):
    """The stages of a campaign, or of a group of several, by name."""
    paths = tuple(Path(os.path.normpath(SETTINGS.raw_dir), folder) for folder in folders)
    return {each.name: each for each in stages(paths, Path(results), CHAIN, load)}


# The stages of any campaign, and how those of a group begin; their files as patterns of paths.
STAGES = stages_of(["a", "b"], result("")) | stages_of(["a"], result(""))
READS = {name: {of: str(path) for of, path in each.reads.items()} for name, each in STAGES.items()}
WRITES = {
    name: {of: str(path) for of, path in each.writes.items()} for name, each in STAGES.items()
}


def words_of(stage):
    """The words of the command line that runs a stage of a campaign."""

    def words(wildcards):
        folders = GROUPS.get(wildcards.campaign, [campaign_of(wildcards)])
        return stages_of(folders, results_folder(wildcards), wildcards.get("load"))[stage].words

    return words


def code_of(*modules):
    """A digest of the files that a command is made of, so that editing one runs it again.

    As a parameter: as inputs the hundred files would be looked at again whenever a job is chosen.
    """
    return lambda wildcards: code_digest(*modules)


def settings_of(section):
    """One section of the settings as JSON: changing another section runs nothing again."""
    text = getattr(SETTINGS, section).model_dump_json()
    return lambda wildcards: text


def sections_of(*sections):
    """Several sections of the settings as one JSON object."""
    text = SETTINGS.model_dump_json(include=set(sections))
    return lambda wildcards: text


def campaign_folder(wildcards):
    if wildcards.campaign in GROUPS:
        return os.path.dirname(description_of(wildcards))
    return os.path.join(os.path.normpath(SETTINGS.raw_dir), campaign_of(wildcards))


def results_folder(wildcards):
    return os.path.join(os.path.normpath(SETTINGS.results_dir), wildcards.campaign)


def logs_of_campaign(wildcards):
    campaign = campaign_of(wildcards)
    if campaign in IMPORTED:  # before the import there is no folder to look into
        return os.path.join(campaign_folder(wildcards), IMPORTED[campaign])
    return raw_files(Path(campaign_folder(wildcards)))


def arm_of_campaign(wildcards):
    """The campaign's own description of its robot; a shipped one is part of the code."""
    if wildcards.campaign in GROUPS:
        folders = [Path(SETTINGS.raw_dir, name) for name in GROUPS[wildcards.campaign]]
        return [path for folder in folders for path in arm_files(folder)]
    return arm_files(Path(campaign_folder(wildcards)))


def campaign_if_there(wildcards):
    """The description, the arm and the logs of a campaign, those that are there."""
    folder = Path(campaign_folder(wildcards))
    there = [path for path in (folder / "campaign.yaml",) if path.is_file()]
    return [*there, *arm_files(folder), *raw_files(folder)]


def name_of_campaign(wildcards):
    return campaign_name(Path(campaign_folder(wildcards)))


def robot_of_campaign(wildcards):
    return robot_name(Path(campaign_folder(wildcards)))


def planes_of(campaign):
    """The Monte Carlo results of a campaign, one a plane; of those with the paper's model alone."""
    return expand(rules.montecarlo.output, campaign=campaign) * (not by_general_model(campaign))


def by_general_model(campaign):
    """Whether the load cases of a campaign are worked out with the general model."""
    if campaign in IMPORTED or campaign in GROUPS:
        return True
    folder = Path(SETTINGS.raw_dir, campaign)
    return planned_by_general_model(
        SETTINGS.calibration.model, robot_name(folder), instrument_kind(folder)
    )


def every(results_of):
    """The results that a function of the campaign names, for every campaign."""
    return lambda wildcards: [path for campaign in EVERY for path in results_of(campaign)]


def trial_result(name):
    """The path pattern of a result of a study of blind trials."""
    return os.path.join(_literal(SETTINGS.results_dir), "{study}", name)


def trial_chunks(kind_of_file):
    """The files of all jobs of a study: so many trials each, numbered from the first of a kind."""

    def files(wildcards):
        from pa10cal_lab.cell.trials import trial_counts  # late: half a second of every start

        size = SETTINGS.blind_trials.trials_a_job
        return [
            trial_result(f"trials/{kind}_{first}_{min(size, count - first)}.{kind_of_file}").format(
                study=wildcards.study
            )
            for kind, count in trial_counts(TRIAL_STUDIES[wildcards.study][1].items()).items()
            for first in range(0, count, size)
        ]

    return files


def curve_result(name):
    """The path pattern of a result of curves and of the chain posed along them."""
    return os.path.join(_literal(SETTINGS.results_dir), "curve", name)


def coverage_result(name):
    """A result of the coverage study."""
    return os.path.join(_literal(SETTINGS.results_dir), name)


def source_option(name):
    """What the fetch is told of a copy of a data set to take in place of the published one."""
    source = SETTINGS.dataset_sources.get(name)
    return f"--source {shlex.quote(source)}" if source else ""


def measured_result(name):
    """The path pattern of a result of the measured campaigns."""
    return os.path.join(_literal(SETTINGS.results_dir), "measured", name)


def import_option(hand):
    """What a measured campaign is imported of, where it is not there already."""
    if hand.dataset is None:
        return ""
    return f"--dataset {hand.dataset} --source {shlex.quote(str(hand.source))}"


def folders_option(folders):
    """The option that lists folders of raw files; nothing where there are none."""
    words = [shlex.quote(str(folder)) for folder in folders]
    return f"--campaign-dir {' '.join(words)}" if words else ""

"""Raw logs of measurement campaigns to calibrated models, figures and tables."""


configfile: f"{workflow.basedir}/config.yaml"


# Jobs run in the environment that runs Snakemake, set up from requirements.lock. A site that must run
# them in containers builds this image from the same lock.
container: "pa10cal.sif"


# Campaigns that the workflow itself makes, of public data sets, and their files of readings.
UR10 = {"ur10-a": "measurements_grid.csv", "ur10-c": "measurements_random_poses.csv"}
IMPORTED = UR10
# One robot of them in several campaigns.
IMPORTED_GROUPS = {"ur10": tuple(UR10)}


include: "workflow/rules/common.smk"
include: "workflow/rules/datasets.smk"
include: "workflow/rules/ingest.smk"
include: "workflow/rules/base_frame.smk"
include: "workflow/rules/calibration.smk"
include: "workflow/rules/montecarlo.smk"
include: "workflow/rules/discovery.smk"
include: "workflow/rules/evaluation.smk"
include: "workflow/rules/export.smk"
include: "workflow/rules/drawn.smk"
include: "workflow/rules/pictures.smk"
include: "workflow/rules/page.smk"
include: "workflow/rules/simulate.smk"
include: "workflow/rules/coverage.smk"
include: "workflow/rules/blind_trials.smk"
include: "workflow/rules/ur10.smk"
include: "workflow/rules/measured.smk"
include: "workflow/rules/curve.smk"
include: "workflow/rules/fleet.smk"
include: "workflow/rules/campaigns.smk"


rule all:
    """Everything, for every campaign of the configuration."""
    default_target: True
    input:
        rules.campaigns.input,

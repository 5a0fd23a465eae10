"""Campaigns from raw logs to models, figures and tables, and nothing else: what `pa10cal run` runs."""


configfile: f"{workflow.basedir}/../config.yaml"


# The campaigns that are run are the reader's own, whatever their names.
IMPORTED = {}
IMPORTED_GROUPS = {}


include: "rules/common.smk"
include: "rules/ingest.smk"
include: "rules/base_frame.smk"
include: "rules/calibration.smk"
include: "rules/montecarlo.smk"
include: "rules/discovery.smk"
include: "rules/evaluation.smk"
include: "rules/export.smk"
include: "rules/drawn.smk"
include: "rules/pictures.smk"
include: "rules/page.smk"
include: "rules/fleet.smk"
include: "rules/campaigns.smk"

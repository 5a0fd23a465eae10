"""The `schema` of each kind of record, for those who write it and those who read it."""

BASE_FRAME = "pa10cal-base-frame/1"
CALIBRATION = "pa10cal-calibration/1"
HOLDOUT = "pa10cal-holdout/1"
MONTECARLO = "pa10cal-montecarlo/1"
COVERAGE = "pa10cal-coverage/1"
MODEL = "pa10cal-model/1"

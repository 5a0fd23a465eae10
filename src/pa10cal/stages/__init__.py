"""Stages from raw files to a model: functions that are commands too, and the one list of them."""

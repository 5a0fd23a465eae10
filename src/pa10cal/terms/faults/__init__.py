"""Faults of a log as terms: what a whole log is wrong by, told and never named as an effect."""

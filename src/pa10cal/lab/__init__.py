"""The laboratory: the virtual cell, trials and studies against a known truth."""

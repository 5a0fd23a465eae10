"""Two-level calibration: inner base frame, outer link parameters and springs."""

"""Other calibration packages and ours, side by side on the same data."""

"""What is measured, as ratios within one run, beside the bars."""

"""Where model and data disagree, which effect is missing, and what to measure next."""

"""Golden results: what the studies gave, frozen small, and the comparison of a run with it."""

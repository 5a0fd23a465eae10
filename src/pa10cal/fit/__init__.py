"""A model fitted to measured poses: what is solved, how it is weighed, and what comes of it."""

"""A model fitted to measured poses: the problem, its weights, its solution and the fitted model."""

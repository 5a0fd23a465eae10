"""Real URDFs: imported, calibrated and exported, and loaded back by two loaders."""

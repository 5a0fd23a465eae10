"""The nominal arm and its chain."""

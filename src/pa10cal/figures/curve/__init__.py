"""Pictures of a chain laid along a curve, one a module."""

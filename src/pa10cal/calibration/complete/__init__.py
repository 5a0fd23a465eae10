"""The complete model: every parameter that arm and instrument can tell, and no other."""

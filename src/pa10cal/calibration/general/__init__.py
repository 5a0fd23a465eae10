"""The general model: every parameter that arm and instrument can tell, and no other."""

"""The general model: every parameter that arm and instrument can identify, and no other."""

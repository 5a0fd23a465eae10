"""Pictures and tables of the study of a chain posed along curves, one a module."""

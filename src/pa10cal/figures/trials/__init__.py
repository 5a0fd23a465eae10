"""Pictures and tables of a study of blind trials, one a module."""

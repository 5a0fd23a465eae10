"""Pictures and tables of a measurement campaign, one a module."""

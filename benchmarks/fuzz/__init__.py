"""Mutations of campaigns and settings: every one is refused by name or comes to a right result."""

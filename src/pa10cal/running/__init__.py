"""The workflow run from the command line, and what a person is shown of it."""

"""The sections of the page, one module each; each takes what was gathered and returns a section."""

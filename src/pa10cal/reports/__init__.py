"""The report of a campaign: one page, read from top to bottom, that needs no network."""

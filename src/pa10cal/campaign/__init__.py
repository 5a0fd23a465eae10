"""Raw logs of a measurement campaign to a table of poses."""

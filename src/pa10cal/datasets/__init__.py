"""Public data sets: fetched or taken from a folder, checked, and written as campaigns."""

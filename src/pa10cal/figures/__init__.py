"""One module a figure or table, drawn from results; the only place for matplotlib."""

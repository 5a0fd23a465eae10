"""Studies in the virtual cell: a whole way from simulation to estimate, held against the truth."""

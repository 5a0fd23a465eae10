"""One module per rule of the workflow: read, call, write; nothing else."""

"""What Snakemake has to know of campaigns and of the code while it plans the jobs."""

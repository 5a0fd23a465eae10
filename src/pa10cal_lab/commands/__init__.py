"""Commands of the laboratory: a function whose signature is the command line."""

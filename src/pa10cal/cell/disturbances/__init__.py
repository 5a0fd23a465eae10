"""What ordinary logs have and what may be wrong in them: one class each, put into raw files."""

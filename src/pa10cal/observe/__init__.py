"""What was measured: observations of any instrument, and what each kind of instrument is."""

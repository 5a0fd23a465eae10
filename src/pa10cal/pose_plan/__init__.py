"""Which poses to measure, before any is measured."""

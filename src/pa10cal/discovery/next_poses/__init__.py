"""Which configurations to measure next, and what they are expected to bring."""

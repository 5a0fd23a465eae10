"""Least squares, and poses chosen by exchange: numbers alone."""

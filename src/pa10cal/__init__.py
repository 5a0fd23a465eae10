"""Geometric and flexibility calibration of serial robot arms, from raw logs to figures."""

__version__ = "0.1.0"

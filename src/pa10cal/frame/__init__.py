"""Frames from points: rigid fits, and the base frame from straight-line moves."""

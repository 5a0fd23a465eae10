"""Readers of data sets, one small module each.

A new data set is one more module here with a constant `DATASET`; `importing` finds it.
"""

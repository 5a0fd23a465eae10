"""The laboratory: the virtual cell, trials and studies against a known truth; what proves pa10cal.

Its records, pictures and commands too. A package beside `pa10cal`, which it imports; that finds it
by name (`docs/architecture.md`).
"""

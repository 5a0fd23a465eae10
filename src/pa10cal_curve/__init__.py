"""A continuous curve as straight links with their ends on it, and the joint angles between them.

The second paper: the curve, its study in the virtual cell, their records, pictures and commands. A
package beside `pa10cal`, which it imports; that finds it by name (`docs/architecture.md`).
"""

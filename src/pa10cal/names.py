"""Names that become folders and files: of campaigns, groups and robots."""

from __future__ import annotations

#: As long as the shortest limit of a usual file system leaves room for an ending.
LONGEST = 100


def fits_a_folder(name: str) -> bool:
    """Return whether a name may become a file or folder, and leads nowhere else.

    It may if it is made of letters, digits, '-', '_' and '.', does not begin with '.' or '-', and
    is not longer than 100 letters.
    """
    whole = all(letter.isalnum() or letter in "-_." for letter in name)
    return 0 < len(name) <= LONGEST and whole and name[0] not in ".-"


#: The same in words.
ALLOWED = (
    f"a name of at most {LONGEST} letters, digits, '-', '_' and '.', not beginning with '.' or '-'"
)

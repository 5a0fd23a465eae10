"""Orientations that a file seems to hold and that are not read, for what a user should check."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from pa10cal.campaign.matrices import quaternion_columns, rotation_columns
from pa10cal.campaign.recognise import Roles, attitude_of, has_word, words_of_name
from pa10cal.campaign.sniffing import Sniffed

#: Words of columns that hold no orientation of a target, whatever else they say.
_NO_ORIENTATION = ("uncertain", "deviation", "no position", "commanded", "torque", "force")
#: Columns of numbers that are called an orientation, at least.
_LEAST = 3
#: The second of two columns of one name, as of another arm.
_AGAIN = re.compile(r".* \(\d+\)")


def orientation_not_read(sniffed: Sniffed, roles: Roles) -> tuple[str, ...]:
    """Return the columns of an orientation that seems to be there and is not read; empty for none.

    By their names or by their numbers, a moving unit quaternion or matrix, or as text.
    """
    free = [name for name in sniffed.names if name not in _read(roles)]
    titles = dict(zip(sniffed.names, sniffed.titles or sniffed.names, strict=True))
    free = [n for n in free if not has_word(words_of_name(titles[n]), *_NO_ORIENTATION)]
    free = [n for n in free if not _AGAIN.fullmatch(titles[n])]
    numbers = {name: sniffed.column(name) for name in free}
    known = [name for name in free if np.isfinite(numbers[name]).mean() > 0.5]
    moving = [name for name in known if np.nanmax(numbers[name]) > np.nanmin(numbers[name])]
    found = attitude_of([titles[name] for name in moving])
    if found is not None:
        return found[0]
    columns = np.column_stack([numbers[name] for name in moving]) if moving else np.zeros((0, 0))
    by_numbers = rotation_columns(moving, columns) or quaternion_columns(moving, columns)
    called = [name for name in free if has_word(words_of_name(titles[name]), "orientation")]
    texts = [n for n in called if n not in known and any("[" in w for w in sniffed.words(n)[:5])]
    called = [name for name in called if name in moving]
    chosen: Sequence[str] = by_numbers or texts or (called if len(called) >= _LEAST else ())
    return tuple(titles[name] for name in chosen)


def _read(roles: Roles) -> set[str]:
    """Return the columns that have a role."""
    read = {*roles.joints, *roles.torques, *roles.uncertain, *roles.uncertain.values()}
    read |= {*roles.times, *roles.single.values(), *(roles.polar or ())}
    read |= {name for names in roles.positions.values() for name in names}
    return read | set(roles.attitude[0] if roles.attitude else ())

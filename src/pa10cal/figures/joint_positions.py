"""Joint positions of the configurations of a campaign, looked up by pose and load."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.errors import RecordError


@dataclass(frozen=True)
class JointPositions:
    """Mean joint positions of configurations over their repeats."""

    q: pd.DataFrame  # one row a pose and load, one column a joint [rad; m of a prismatic joint]
    slides: NDArray[np.bool_]  # (n,) which joints slide

    def of(self, poses: Sequence[str], loads_N: Sequence[float]) -> Array:
        """Return the joint positions (P, n) of P poses, each at its load.

        Raises:
            RecordError: when one of them was not measured.
        """
        rows = pd.MultiIndex.from_arrays([list(poses), list(loads_N)])
        found = self.q.reindex(rows).to_numpy(dtype=float)
        unknown = np.isnan(found).any(axis=1)
        if unknown.any():
            pose, load_N = rows[int(np.argmax(unknown))]
            raise RecordError(
                "a pose of the results is not in the table of poses",
                where="ingest/poses.parquet",
                value=f"{pose} at {load_N:g} N",
                allowed="results of the poses that ingest wrote",
                remedy="run pa10cal calibrate and pa10cal evaluate again",
            )
        return found

"""Learners of scikit-learn on residuals; runs in an environment of its own, without pa10cal.

`python learners.py FILE` reads arrays `seen`, `left`, `asked` of an .npz file, (P, f), (P, b) and
(H, f), and writes what each learner predicts, (H, b), into it beside them.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from sklearn.ensemble import ExtraTreesRegressor, HistGradientBoostingRegressor
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.multioutput import MultiOutputRegressor

Array = NDArray[np.float64]

#: Poses by which the lengths of a Gaussian process are found: its cost grows with their cube.
_OF_LENGTHS = 400


def gaussian_process(seen: Array, left: Array, asked: Array) -> Array:
    """Predict by a Gaussian process with a length for each feature, and its noise."""
    size = left.std() or 1.0
    kernel = ConstantKernel(0.5) * RBF(np.full(seen.shape[1], 2.0), (0.1, 1e3))
    kernel += WhiteKernel(0.3, (1e-4, 10.0))
    some = np.random.default_rng(0).permutation(len(seen))[:_OF_LENGTHS]
    found = GaussianProcessRegressor(kernel, random_state=0).fit(seen[some], left[some] / size)
    fixed = GaussianProcessRegressor(found.kernel_, optimizer=None).fit(seen, left / size)
    return np.asarray(fixed.predict(asked)).reshape(len(asked), -1) * size


def trees(seen: Array, left: Array, asked: Array) -> Array:
    """Predict by the mean of many trees whose splits are drawn."""
    found = ExtraTreesRegressor(400, min_samples_leaf=3, random_state=0).fit(seen, left)
    return np.asarray(found.predict(asked)).reshape(len(asked), -1)


def boosted(seen: Array, left: Array, asked: Array) -> Array:
    """Predict by trees that each learn what those before leave."""
    tree = HistGradientBoostingRegressor(max_iter=150, learning_rate=0.06, random_state=0)
    return np.asarray(MultiOutputRegressor(tree).fit(seen, left).predict(asked))


LEARNERS = (gaussian_process, trees, boosted)


def predicted(seen: Array, left: Array, asked: Array) -> Iterator[tuple[str, Array]]:
    """Yield each learner's name with what it predicts."""
    middle, scale = seen.mean(axis=0), seen.std(axis=0)
    kept = scale > 1e-9
    seen, asked = ((each - middle)[:, kept] / scale[kept] for each in (seen, asked))
    for learner in LEARNERS:
        yield learner.__name__, learner(seen, left, asked)


def main(path: str) -> None:
    """Read the arrays, learn, and write the predictions beside them."""
    # A length at its bound is a feature that nothing goes with.
    warnings.simplefilter("ignore", ConvergenceWarning)
    with np.load(path) as file:
        given = {name: file[name] for name in ("seen", "left", "asked")}
    np.savez(path, **given, **dict(predicted(**given)))


if __name__ == "__main__":
    main(sys.argv[1])

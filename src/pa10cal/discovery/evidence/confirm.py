"""Is an effect there? Sign flips over poses, and poses and loads held out.

The unit of evidence is the pose. If an effect is absent, what it seems to explain at one pose has
either sign; flipping all rows of a pose together keeps whatever its loads, repeats and components
share. The largest gain of any candidate under flips is what chance makes of this family on these
data (max-T), whatever the noise really is.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.linalg import cho_factor, cho_solve

from pa10cal.arrays import Array, Index
from pa10cal.discovery.evidence.candidates import linearise
from pa10cal.discovery.evidence.likelihood import SIZES, Block
from pa10cal.discovery.evidence.problem import NoiseModel, Problem, Whitening
from pa10cal.discovery.evidence.search import EndOfSearch
from pa10cal.results.discovery import CrossValidation, EvidenceByRepeats
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.weights import Weights

FLIPS = 999
#: Probability allowed that chance makes as much of the family, by sign flips over poses.
FLIP_RATE = 0.05
#: A name without one pose keeps more of its evidence than this, or that pose alone carries it.
CARRIED = 0.5
_FOLDS = 9
_SEED = 20080427


class Confirmation(EvidenceByRepeats):
    """What speaks for one effect, all others being in the model."""

    carrier: str | None = Field(
        default=None,
        exclude=True,
        description="the one pose without which not half of this would be left, and too "
        "little for a name; None where there is no such pose",
    )

    @property
    def gain(self) -> float:
        """Part of the squared error of poses left out that it explains."""
        return self.cross_validation_over_poses.explained


@dataclass(frozen=True)
class WeighedRows:
    """Weighed rows of both channels."""

    own: Array  # (R, k) of the model's own parameters and of the members
    members: tuple[slice, ...]  # columns of each member in `own`
    data: Array  # (R,) measured minus predicted
    family: tuple[Array, ...]  # rows of each candidate
    cell: Index  # (R,) the cell of each row


def confirm(problem: Problem, found: EndOfSearch, needed: float = 0.0) -> tuple[Confirmation, ...]:
    """Confirm every effect that the search found.

    Args:
        problem: the campaign.
        found: where the search ended.
        needed: evidence that a name needs, natural logarithm.
    """
    if not found.fit.effects:
        return ()
    rows = weighed_rows(problem, found, found.family)
    unturned = weighed_rows(problem, found, found.fit.effects, turned=False)
    labels, pose = np.unique(problem.cells.pose, return_inverse=True)
    load_N = problem.cells.states.load_N
    loads, load = np.unique(load_N, return_inverse=True)
    generator = np.random.default_rng(_SEED)
    signs = generator.choice([-1.0, 1.0], (FLIPS, int(pose.max()) + 1))
    confirmed = []
    for k, without in enumerate(found.without):
        confirmed.append(
            Confirmation(
                lost_without_it_nats=found.score.log_evidence - without.log_evidence,
                needed_nats=needed,
                p_sign_flips_max_t=_flipped(rows, k, pose, signs),
                p_needed=FLIP_RATE,
                cross_validation_over_poses=_left_out(rows, k, pose % _FOLDS, pose),
                cross_validation_over_loads=_left_out(unturned, k, load, pose)
                if len(loads) > 1
                else None,
                carrier=_carrier(rows, k, pose, labels, needed),
            )
        )
    return tuple(confirmed)


def weighed_rows(
    problem: Problem, found: EndOfSearch, family: tuple[Effect, ...], *, turned: bool = True
) -> WeighedRows:
    """Return all rows by independent errors of unit variance.

    Args:
        problem: the campaign.
        found: where the search ended.
        family: candidates; effects that the search holds are members besides.
        turned: by what the cells of a pose share, else by cell.
    """
    others = tuple(effect for effect in found.fit.effects if effect not in family)
    lin = linearise(problem, found.fit, (*family, *others))
    blocks = dict(zip((*family, *others), lin.blocks, strict=True))
    score = found.score
    size = dict(zip(found.fit.effects, found.fit.sizes, strict=True))

    def rows_of(channel: NoiseModel, variance: float, rows: Array) -> Array:
        if turned:
            return channel.whitening(variance)(rows)
        cells, b, _ = channel.whitener.shape
        weighed = channel.whitening(0.0)(rows).reshape(cells, -1)
        back: Array = (channel.shared.turn.T @ weighed).reshape(cells * b, -1)
        return back

    def both(pose_rows: Array, torque_rows: Array) -> Array:
        found_rows = rows_of(problem.pose, score.pose_variance, pose_rows)
        if problem.torque is None:
            return found_rows
        return np.concatenate(
            [found_rows, rows_of(problem.torque, score.torque_variance, torque_rows)]
        )

    def block(candidate: Block, scale: float) -> Array:
        factor = scale * candidate.factor
        return both(candidate.pose @ factor, candidate.torque @ factor)

    own = both(lin.own, np.zeros((len(lin.torque_data), lin.own.shape[1])))
    # Weights that are uncertain are an error that all poses share: as parameters they would take up
    # what their uncertainty leaves no room for.
    uncertain = _of_weights(found)
    known = Whitening.of(np.ones(len(own)), own[:, uncertain])
    own = known(own[:, ~uncertain])
    of_members = [known(block(blocks[effect], SIZES[size[effect]])) for effect in found.fit.effects]
    stops = np.cumsum([own.shape[1], *(part.shape[1] for part in of_members)]).tolist()
    cells = [np.repeat(np.arange(len(problem.cells)), problem.pose.whitener.shape[1])]
    if problem.torque is not None:
        cells.append(np.repeat(np.arange(len(problem.cells)), problem.torque.whitener.shape[1]))
    return WeighedRows(
        own=np.concatenate([own, *of_members], axis=1),
        members=tuple(slice(a, b) for a, b in pairwise(stops)),
        data=known(both(lin.pose_data[:, None], lin.torque_data[:, None]))[:, 0],
        family=tuple(known(block(blocks[effect], 1.0)) for effect in family) if turned else (),
        cell=np.concatenate(cells),
    )


def _of_weights(found: EndOfSearch) -> NDArray[np.bool_]:
    """Return which of the model's own columns are weights that are uncertain."""
    model = found.fit.model
    places = [
        np.arange(len(found.fit.x))[model.columns_of(term)]
        for term in model.terms
        if isinstance(term, Weights)
    ]
    return np.isin(found.fit.own_columns(), np.concatenate([np.zeros(0, np.intp), *places]))


def _flipped(rows: WeighedRows, k: int, pose: Index, signs: Array) -> float:
    """Return the share of sign flips in which some candidate gains as much as member k."""
    others = np.delete(rows.own, rows.members[k], axis=1)
    factor = cho_factor(others.T @ others + np.eye(others.shape[1]))

    def left(columns: Array) -> Array:
        taken: Array = columns - others @ cho_solve(factor, others.T @ columns)
        return taken

    data = left(rows.data[:, None])
    mine = _gain(*_scores(left(rows.own[:, rows.members[k]]), data, pose[rows.cell]), None)
    highest = np.full(len(signs), -np.inf)
    for columns in rows.family:
        highest = np.maximum(highest, _gain(*_scores(left(columns), data, pose[rows.cell]), signs))
    return float((1 + np.count_nonzero(highest >= mine[0])) / (1 + len(signs)))


def _carrier(
    rows: WeighedRows, k: int, pose: Index, labels: NDArray[np.str_], needed: float
) -> str | None:
    """Return the pose without which nearly nothing speaks for member k; None for none.

    The products of each pose are taken from the sums; sizes and weights stay as they are.
    """
    columns = np.concatenate([rows.own, rows.data[:, None]], axis=1)
    own = np.arange(rows.own.shape[1])
    without = np.delete(own, rows.members[k])
    total = columns.T @ columns

    def loss(products: Array) -> float:
        return _log_evidence(products, own) - _log_evidence(products, without)

    of_row, whole = pose[rows.cell], loss(total)
    left = np.empty(len(labels))
    for number in range(len(labels)):
        part = columns[of_row == number]
        left[number] = loss(total - part.T @ part)
    worst = int(left.argmin())
    carried = left[worst] < min(needed, CARRIED * whole)
    return str(labels[worst]) if carried else None


def _log_evidence(products: Array, own: Index) -> float:
    """Return the log evidence of columns of unit size, up to a constant of the data."""
    lower, _ = factor = cho_factor(products[np.ix_(own, own)] + np.eye(len(own)))
    projection = products[own, -1]
    gained = float(projection @ cho_solve(factor, projection))
    return 0.5 * gained - float(np.log(np.diag(lower)).sum())


def _scores(columns: Array, data: Array, pose: Index) -> tuple[Array, Array]:
    """Return products of columns and data pose by pose (P, k), and of columns (k, k)."""
    scores = np.zeros((int(pose.max()) + 1, columns.shape[1]))
    np.add.at(scores, pose, columns * data)
    return scores, columns.T @ columns


def _gain(scores: Array, gram: Array, signs: Array | None) -> Array:
    """Return the gain in evidence under each flip of signs (F, P), or as measured."""
    values, vectors = np.linalg.eigh(gram)
    values = np.maximum(values, 0.0)
    total = (scores.sum(axis=0, keepdims=True) if signs is None else signs @ scores) @ vectors
    sizes = np.array(SIZES)[:, None] ** 2
    explained = (total**2) @ (sizes / (1.0 + sizes * values)).T
    found: Array = 0.5 * (explained - np.log1p(sizes * values).sum(axis=1)).max(axis=1)
    return found


def _left_out(
    rows: WeighedRows, k: int, fold_of_cell: Index, pose_of_cell: Index
) -> CrossValidation:
    """Return how member k does on each fold, all being fitted on the others."""
    fold, pose = fold_of_cell[rows.cell], pose_of_cell[rows.cell]
    without = np.delete(rows.own, rows.members[k], axis=1)
    errors = []
    for own in (rows.own, without):
        everything = np.concatenate([own, rows.data[:, None]], axis=1)
        total = everything.T @ everything
        squares = np.zeros(int(pose.max()) + 1)
        for number in np.unique(fold):
            here = fold == number
            part = everything[here]
            products = total - part.T @ part
            factor = cho_factor(products[:-1, :-1] + np.eye(own.shape[1]))
            left = part[:, -1] - part[:, :-1] @ cho_solve(factor, products[:-1, -1])
            np.add.at(squares, pose[here], left**2)
        errors.append(squares)
    gain = errors[1] - errors[0]
    spread = float(gain.std(ddof=1)) / np.sqrt(len(gain))
    return CrossValidation(
        explained=float(gain.sum() / errors[1].sum()),
        z=float(gain.mean() / spread) if spread > 0 else 0.0,
    )

"""Tuning constants of discovery: fields, formulas, poses, fits, and sessions of the arm.

Those of sessions and short forms decide what verdicts tell of sessions and formulas. All other
numbers on which verdicts depend are in `discovery/rules.py`; `docs/discovery.md` has all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pa10cal.arrays import Array


@dataclass(frozen=True)
class Field:
    """What is predicted without a name."""

    # knots of a map, which stays as it was fitted to all poses: beside finer ones poses held out do
    # not judge what else is fitted (measured)
    most_knots: int = 100
    standard_errors: float = 2.0  # standard errors over groups by which poses must gain (level)
    least_gain: float = 0.05  # part of their squares that poses held out must gain (size)
    most_loss: float = 0.02  # part of their squares that whole regions may lose (measured)
    groups: int = 10  # groups that are held out in turn (computing)
    group_poses: int = 4  # poses a group at least (statistics)
    lengths: tuple[float, ...] = (0.1, 0.2, 0.4, 0.8, 1.6)  # in the spread of poses (computing)
    # the same of a rough one; any longer one differs by its size alone (measured)
    rough_length: float = 1.6
    # sizes of a displacement, over the scatter of a row: lowest, highest [m], count (computing)
    sizes_m: tuple[float, float, int] = (1e-7, 0.1, 61)
    most_places: int = 100  # places that it goes through (computing)
    most_poses: int = 2000  # poses that it is fitted to (computing)
    least_scatter: float = 1e-12  # of squares, which a fit through all rows leaves (computing)
    least_joint_part: float = 0.01  # joints that less of it goes with are not told (told)
    # plausible sizes of an effect without a name: none, at first, at most (9 mrad of tilt) (size)
    sizes: tuple[float, float, float] = (1e-3, 0.1, 30.0)
    size_steps: tuple[int, int] = (20, 300)  # steps of expectation to them, and in all (computing)
    settled: float = 1e-3  # change of a variance, in its logarithm, at the last one (computing)


@dataclass(frozen=True)
class Sessions:
    """Whether rows without times are of two sessions, with another place of the base in either."""

    least_poses: int = 10  # poses of a session, at least (statistics)
    # nats by which another base from a row on must gain after its unknowns, and more than from an
    # angle of any joint on (level)
    least_nats: float = 4.6
    least_singular: float = 1e-9  # singular values that are none, in the largest (computing)
    # parts of the rows after which repeats are looked at for a step (computing)
    parts: tuple[float, ...] = tuple(round(0.1 * k, 1) for k in range(1, 10))
    # share of its squares below which a motion of the base is one of the model's (computing)
    least_share: float = 1e-10


@dataclass(frozen=True)
class NextPoses:
    """What to measure next, to bring rivals apart."""

    # a pair that the best poses bring apart by less cannot be distinguished: odds of 20 to 1 [nat]
    # (level)
    apart_nats: float = 3.0
    pool: int = 1024  # poses drawn to choose from (computing)
    most_pairs: int = 8  # pairs that poses are sought for (told)
    # probability that stands for those of an effect that these poses cannot show, and of its
    # absence, both together: well below those of what was found (level)
    hidden: float = 0.1
    # what a pair that is as good as settled still counts, times log (1 + d) of its log evidence d
    # [bit] (computing)
    further_bits: float = 1e-3
    most_sweeps: int = 2  # sweeps of exchanges (computing)
    # parameters of models that poses are sought for: of more they would take many times as long as
    # the search (computing)
    most_parameters: int = 400
    most_measured: int = 1000  # measured poses that stand for more (computing)
    limit_share: float = 0.05  # part of each joint's range kept clear at either end (safety)
    # least width by which the box of the measured places is widened [m] (safety)
    box_margin_m: float = 0.3
    # end and targets stay so far above the base's origin, unless poses were measured nearer [m]
    # (safety)
    floor_m: float = 0.15
    column_m: float = 0.25  # and so far off its axis [m] (safety)
    # and targets so far off the line from joint to joint [m] (safety)
    clearance_m: float = 0.15
    # distances that differ by less are equal but for rounding, as of a target close to the last
    # link in every pose [m] (computing)
    same_m: float = 1e-9
    # log evidence between which what it says is worked out: lowest, highest, count (computing)
    grid_nats: tuple[float, float, int] = (1e-3, 1e3, 240)
    quadrature: int = 100  # nodes over what evidence may come to (computing)
    least: float = 1e-12  # least probability of a rival (computing)
    drawn: int = 2000  # poses drawn to find some at angles not seen (computing)


@dataclass(frozen=True)
class Places:
    """Where what remains sits, for pictures and words."""

    # joint error thought possible, a standard deviation, where a pose cannot separate joints [rad]
    # (size)
    possible_rad: float = 1e-3
    least_order: float = 0.5  # lowest order of the periodogram [cycles a turn] (computing)
    most_ratios: float = 2.5  # highest order, in gear ratios of the joint (trials)
    # gear ratio by which that is counted where the arm's own is not known (size)
    usual_ratio: float = 100.0
    steps_a_peak: int = 5  # steps of the periodogram within the width of a peak (computing)
    largest_step: float = 0.25  # its largest step [cycles a turn] (computing)
    most_cells: int = 1200  # cells, spread evenly over time, that stand for more (computing)
    digits: int = 6  # digits of what is drawn (told)
    most_shown: int = 8  # effects that are printed (told)


@dataclass(frozen=True)
class Computing:
    """Numbers that change how long a fit takes, or its last digits."""

    no_part: float = 1e-9  # rows with less of the shared error than this have none (computing)
    same_share: float = 1e-9  # what differs by a smaller part is the same (computing)
    not_fitted: float = 1e-9  # size of a parameter that is not to be fitted (computing)
    no_waves_rad: float = 1e-12  # size of waves that a map has no knots for [rad] (computing)
    # poses times columns of rows that are kept, where they are needed again (computing)
    most_kept: int = 1_000_000
    tiny: float = 1e-300  # a sum of weights that is none (computing)
    # correlations are kept from one, where their transform has no end (computing)
    most_correlation: float = 1.0 - 1e-9
    # longest lag that counts for a correlation length, in the range of the angles (statistics)
    correlation_lags: float = 0.25
    # a step that lowers the sum of squares by less than this part is the last (computing)
    fit_precision: float = 1e-8
    fit_steps: int = 50  # steps of such a fit (computing)
    fit_damping: float = 1e-6  # its first damping (computing)
    refit_steps: int = 6  # steps of a refit of everything (computing)
    refit_damping: float = 1e-3  # damping that hardly shortens a step (computing)
    refit_arrived: float = 0.1  # a step this small, in standard uncertainties, ends it (computing)
    # a fit that sets out nearby ends where a step gains no more than this part of what is left
    # (computing)
    nearby_settled: float = 1e-4
    nearby_steps: int = 20  # steps of that fit (computing)
    band_steps: int = 40  # steps of a climb of bands (computing)
    band_longest: float = 1.0  # longest step of a logarithm (computing)
    band_damping: float = 0.1  # least damping after a step that led downhill (computing)
    # gain of twice the log-likelihood below which the climb ends (computing)
    band_settled: float = 0.1
    band_difference: float = 1e-4  # step of its differences (computing)
    damping_up: float = 10.0  # by which damping grows after it (computing)
    damping_down: float = 0.1  # and falls after a good step (computing)
    refit_no_worse: float = 1e-9  # part by which a step of a refit may end worse (computing)
    noise_steps: int = 60  # steps by which variances of joints are found (computing)
    least_singular: float = 1e-9  # singular values that are none, in the largest (computing)
    least_determinant: float = 1e-9  # a determinant that is none, in weights squared (computing)
    least_weight: float = 1e-12  # least weight of a line, in the largest (computing)


@dataclass(frozen=True)
class Forms:
    """Short formulas for what has no name."""

    standard_errors: float = 3.0  # standard errors over blocks by which a form must help (level)
    # part of what is over the noise that it must take away (trials)
    least_explained_share: float = 0.8
    # standard errors within which forms do equally well: the best of many is so by chance, too
    # (level)
    tie_errors: float = 2.0
    # part of what the better one gains that another may lose and do equally well, where that is
    # more than an effect must gain: of large gains standard errors are those of their own scatter
    # (trials)
    most_lost_share: float = 0.05
    # what squared errors of two right forms are expected to differ by, in squares of the noise
    # (statistics)
    chance_squares: float = 2.0
    # errors over noise that may be left where there is no map to do as well as (trials)
    over_noise: float = 1.1
    refined: int = 12  # forms that are looked at between their neighbours (computing)
    refined_rounds: int = 2  # so many times (computing)
    refined_places: int = 9  # at so many places between (computing)
    at_once: int = 256  # forms whose columns are made at once (computing)
    kept: int = 48  # forms that few poses do not rule out (computing)
    # standard errors within which a form must do as well in some poses, to be tried in all (level)
    few_errors: float = 3.0
    most_others: int = 6  # other forms that are listed as doing as well (told)
    # poses by which forms are ruled out, where there are many more (computing)
    few_poses: int = 800
    # parameters of maps and rivals that one form may stand for: fine maps of several joints are no
    # one formula (trials)
    most_parameters: int = 400


FIELD = Field()
FORMS = Forms()
NEXT_POSES = NextPoses()
SESSIONS = Sessions()
PLACES = Places()
COMPUTING = Computing()


def none_and_spaced(lowest: float, highest: float, count: int) -> Array:
    """Return none, and values evenly spaced in their logarithm, (count + 1,)."""
    return np.append(0.0, np.geomspace(lowest, highest, count))

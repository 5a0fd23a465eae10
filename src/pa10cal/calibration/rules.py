"""Every number that a calibration hangs on, once: what it bounds, its unit and where it is from.

Where it is from, in brackets: as in `discovery/rules.py`; `measured`, what measured robots need.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri


@dataclass(frozen=True)
class Grades:
    """How good a calibration is said to be."""

    # remaining error over the noise above which a model lacks something (trials)
    over_noise: float = 1.25
    # remaining error over the noise above which the sentence of a good grade states both (told)
    noticed_ratio: float = 1.1
    chance_errors: float = 3.0  # standard deviations by which chance may exceed a limit (level)
    # what the places of the targets of one apparatus leave, over what is expected: they are
    # few numbers, drawn once (statistics)
    apparatus_ratio: float = 2.0
    # held-out over expected error above which the model does not predict as it promises (measured)
    over_expected: float = 1.3
    # scatter of repeats over the stated uncertainty from which on it is told (told)
    repeats_told: float = 1.5
    # stated over found uncertainty, either way, above which one of them is wrong (trials)
    stated_ratio: float = 3.0
    # the same of orientations, whose uncertainty is mostly taken from that of positions: a
    # unit is wrong (trials)
    attitude_ratio: float = 30.0
    # the same of touched balls, where it holds what all touches of a ball share (form of
    # ball and stylus), which repeats do not show (trials)
    touches_ratio: float = 15.0
    # remaining error over a stated noise that nothing else confirms, above which its unit is in
    # doubt: a unit is off by 1000, an effect of the arm leaves less than 100 times the noise (size)
    unit_ratio: float = 300.0
    # held-out over remaining error, or over the noise, beside the uncertainty of predictions, up to
    # which held-out poses confirm a model (measured)
    confirmed_ratio: float = 2.0
    few_held_out: int = 5  # held-out poses that it takes for that (statistics)
    # readings for each degree of freedom taken with which poses that fit to the noise stand in for
    # them, where none are held out (statistics)
    rows_an_unknown: float = 2.0
    # a joint off by whole turns of its motor is off by them to within this part of a turn (size)
    of_a_turn: float = 0.1
    # a length whose sign is wrong is off by twice itself, to within this part of it (size)
    of_a_length: float = 0.1
    # an end-effector that turned by less over all poses was held in one orientation [rad] (size)
    hardly_turned_rad: float = 0.1
    # what the reading of a joint may scatter by: encoders of arms resolve this and less
    # [rad] (size)
    joint_rad: float = 1e-5
    far_off_ratio: float = 20.0  # departure over tolerance that no arm was built with (size)
    # a link is long from this part of the longest on (size)
    long_share: float = 0.5
    # standard uncertainty of its length, relative, up to which it is compared with others (size)
    length_known: float = 3e-4
    longer_share: float = 1e-3  # share by which long links are longer that is told (told)
    # how far each may be off their mean share, relative, to be longer by the same one (trials)
    alike_share: float = 0.05
    # remaining error, in the spread of the measured positions, that no calibrated arm has (size)
    no_fit_share: float = 0.01
    # part of the squared error that springs leave where they explain the larger part: a
    # robot soft by a hundredth of its reach lacks an effect, it is no other robot (trials)
    mostly_share: float = 0.7
    # uncertainty of the model, in the remaining error, that adds 5 % to it: poses that
    # would do are told for it (told)
    small_share: float = 0.3
    # condition number in scaled parameters above which some direction is poorly determined
    # (statistics)
    condition: float = 1e5
    most_names: int = 4  # names that a sentence lists (told)
    # a stated uncertainty in another unit is off by its factor, within this (size)
    of_unit: float = 4.0
    # standard uncertainty of a windup, in its size, and of a length or angle beside open weights,
    # in its typical size, below which poses show it (statistics)
    shown_share: float = 0.5
    # part of the spread of the places seen that no calibrated arm is off by, where held-out
    # poses do not confirm it (size)
    no_fit_general_share: float = 0.05
    # distinct places for each reading, at most, where few are touched again and again (size)
    touched_share: float = 0.25
    # root mean square error over that of the noise above which the paper's model lacks
    # something (trials)
    paper_incomplete: float = 3.0
    # mean square over median scatter, both as of a normal deviate, that a few gross errors
    # make (statistics)
    paper_gross: float = 3.0
    # standard uncertainties beyond a bound that noise reaches in one case of twenty (level)
    paper_pull: float = 2.0
    # turn off the seeded base frame that is told: straight lines give it to about the
    # nominal model's own error, near 1 deg [deg] (trials)
    far_from_seed_deg: float = 3.0
    # pairs of readings below which their scatter says too little about a factor of three
    # (statistics)
    scatter_pairs: int = 20
    # median of the square of a normal deviate (statistics)
    median_square: float = float(ndtri(0.75)) ** 2
    # part of the rows that unknowns are thought to take up at most (statistics)
    most_taken_share: float = 0.9
    tiny: float = 1e-300  # a ratio that is none (computing)


@dataclass(frozen=True)
class Checks:
    """Mistakes in the input that a campaign is searched for."""

    most_poses: int = 100  # poses that a check looks at, spread over all (computing)
    # error left over that of the stated noise above which the input is searched for a cause
    # (trials)
    above_noise: float = 5.0
    # temperatures at which arms are measured [°C] (size)
    laboratory_C: tuple[float, float] = (0.0, 50.0)
    # part of the error that another direction of gravity must leave at most (trials)
    gravity_left_share: float = 0.5
    follows: float = 0.9  # correlation of logged torques that follow those of the masses (trials)
    does_not_follow: float = 0.8  # correlation of those that do not (trials)
    # factors between readings and arm that are sought (size)
    scales: tuple[float, float] = (0.2, 5.0)
    # how far from 1 one is to be a mistake: no instrument, and no arm, is off by more than
    # a thousandth of its lengths (size)
    another_scale: float = 0.01
    about_scale: float = 1.3  # how far about a first estimate the factor is looked for (computing)
    # misfit of the nominal arm, base and target fitted, that no departures explain, of an arm of
    # usual size [m] (size)
    not_departures_m: float = 0.01
    # median angle of the orientations off it that none of an arm explains (size)
    attitude_off_rad: float = float(np.radians(20.0))
    # part of the misfit of the nominal arm that a change must leave at most (trials)
    nominal_left_share: float = 1.0 / 3.0
    calibrated_left_share: float = 0.4  # part of that of a calibrated one (trials)
    no_mastering_deg: float = 1.0  # mastering of a joint is never off by more [deg] (size)
    # a change that puts the nominal arm so much further off is not tried with a calibration
    # (computing)
    worth_trying: float = 3.0
    most_changes: int = 3  # changes of a log that are made one after the other (computing)
    scale_precision: float = 1e-5  # relative precision of the factor found (computing)
    # part of the misfit of the nominal arm that a right change may leave, where that is more
    # than departures explain (trials)
    misfit_left_share: float = 0.1
    same_gravity: float = 0.9  # directions of gravity nearer than this cosine are one (computing)
    # misfit of the shape of targets over what is usual that is a mistake (trials)
    shape_ratio: float = 10.0
    shape_errors: float = 5.0  # the same in its standard uncertainties (trials)
    # misfit of the nominal arm, in the spread of the measured positions, that only a joint that
    # was not logged leaves (size)
    no_arm_share: float = 0.05
    # part of the misfit that one more change may leave to be taken (trials)
    change_left_share: float = 0.7
    # steps of the pitch of a screw [mm/turn] by which the nominal arm tells it, and then
    # calibrated ones (computing)
    screw_steps_mm: tuple[float, float, float] = (20.0, 1.0, 0.2)
    # error left over the noise above which a pitch is sought by calibrating (trials)
    screw_above_noise: float = 1.5


@dataclass(frozen=True)
class Springs:
    """Springs of joints: which are there, and where they start."""

    # part of the largest torque that a joint's must vary by for its spring to be there,
    # whether or not the readings show it (trials)
    full_torque_share: float = 0.02
    # part by which it must vary for its spring to be looked for (trials)
    least_torque_share: float = 0.005
    no_torque_Nm: float = 1e-9  # less than this is none [N m] (computing)
    usual_Nm_per_rad: float = 5e4  # a usual stiffness, from which springs start [N m/rad] (size)
    # a usual sag, from which springs under assumed weights start [rad] (size)
    usual_sag_rad: float = 3e-4
    # a large one, about which that of any robot lies: a 3 m robot sags by milliradians [rad] (size)
    large_sag_rad: float = 5e-3
    rigid_rad: float = 1e-9  # a joint counts as rigid at this windup [rad] (size)
    clusters: int = 10  # clusters of poses held out in turn, where springs are weighed (trials)
    cluster_poses: int = 2  # poses of each, at least (statistics)
    # of a path, an error of held-out clusters larger by this factor is worse (measured)
    worse_ratio: float = 1.05
    finest_m: float = 1e-12  # errors below this are rounding [m] (computing)


@dataclass(frozen=True)
class Unknowns:
    """Which parameters are unknowns, and how far they may go."""

    configurations: int = 60  # joint positions at which redundancy is judged (computing)
    # rows of all of them, in the columns of which the independent ones are sought, at least
    # (computing)
    rows_a_column: float = 1.5
    random_seed: int = 1  # their random seed (computing)
    # part of a column that must remain beside those before it: exact redundancy leaves
    # 1e-13 (computing)
    least_left: float = 1e-8
    # columns below this part of the largest are rounding: of a target on the axis of a joint, or of
    # a base turned about the line to an instrument that measures distances (computing)
    no_column: float = 1e-12
    # no parameter replaces another if it has to move the target so many times further (trials)
    most_times: float = 5.0
    # reach of an unknown in its scale, where it has no physical range (size)
    reach_scales: float = 30.0
    # a target on the flange is about so far from where it is stated to be [m] (size)
    stated_target_m: float = 2e-3
    # and about so far from the flange where that is not stated [m] (size)
    unstated_target_m: float = 0.2
    # degrees of freedom from which on residuals say that the stated noise is too large (statistics)
    least_dof: int = 10
    # a parameter is determined by a campaign that knows it to this part of what it may well
    # be (statistics)
    determined_share: float = 0.1
    # random postures at which it is found what no pose determines, in the paper's model (computing)
    paper_postures: int = 60
    # a parameter takes part in a direction that is not identified by this part of the largest there
    # (chosen)
    mostly_share: float = 0.5
    no_part: float = 1e-6  # part of a parameter in another that is none (computing)
    no_row: float = 1e-9  # rows of a pose that are none (computing)
    same_length: float = 1e-9  # lengths of two arms that are the same [m, rad] (computing)


@dataclass(frozen=True)
class Groups:
    """Campaigns of one robot together, and arms about a model of another campaign."""

    # campaigns contradict each other where chance makes such a difference more rarely (level)
    chance_rate: float = 1e-3
    # and parameters of its own take away this part of one's squared error (trials)
    matters_share: float = 0.1
    # causes of that whose log likelihoods differ by less are told together [nat] (level)
    as_well_nats: float = 3.0
    mostly_share: float = 0.5  # a cause is told as such from this part of the chi-square on (told)
    most_scale: float = 0.01  # largest error of an instrument's scale (size)
    most_range_m: float = 0.02  # and of its distances, as by another reflector [m] (size)
    # variance of a parameter that its fit left at the end of its range, in squares of its
    # scale (size)
    bound_squares: float = 30.0
    # searches for what moved, each about the fit with what the one before found (computing)
    most_rounds: int = 4
    # readings that scatter by so many times what the instrument states contradict what was
    # found (trials)
    contradicted_ratio: float = 1.5
    # and the arm is taken as new where that leaves so small a part (trials)
    explained_share: float = 0.75
    # few readings that scatter by so many times what was expected are explained by no few
    # changes (trials)
    unexplained_ratio: float = 3.0
    # readings for each unknown of an arm taken as new, below which they are few (trials)
    few_readings: float = 4.0
    # of an arm taken as new, what moved by so many standard uncertainties is named (level)
    clear_errors: float = 5.0
    most_named: int = 6  # the clearest of it (told)
    at_once: int = 300  # poses whose derivatives by frames and arm are held at once (computing)


@dataclass(frozen=True)
class Fit:
    """When a fit has arrived."""

    most_steps: int = 50  # of a fit for which no setting says so (computing)
    # a step this small ends the search, in standard uncertainties (computing)
    arrived_errors: float = 1e-4
    # and so does one that leads nowhere if it is this small (computing)
    nearly_errors: float = 1e-3
    # a point from which the next step is this small is where it leads (computing)
    there_errors: float = 1e-5
    # in the valley of unstated weights and springs, along which no prediction changes,
    # steps so many times longer end it (trials)
    valley_times: float = 200.0
    # predictions stand still where they moved by so little, in standard uncertainties (measured)
    still_errors: float = 0.05
    still_steps: int = 8  # in so many steps (measured)
    # a step ahead so many times as long as those taken is one along a valley (trials)
    not_taken_times: float = 5.0
    bottom_errors: float = 0.5  # at its bottom it would move predictions by less than this (trials)
    no_worse: float = 1e-9  # growth of the weighted squares that is rounding, relative (computing)
    # weights have moved on where they move a pose by more [m] (computing)
    moves_nothing_m: float = 1e-7
    # fits more that bring them to rest: what sag moves weights by is a thousandth of the
    # sag (computing)
    most_refits: int = 3
    # starts whose cost is within this part of the best have found the same minimum (computing)
    same_cost: float = 1e-6
    # relative changes at which linear springs are near enough to start cubic ones (computing)
    good_enough: float = 1e-6
    cubic_share: float = 0.01  # cubic share that they start with (computing)
    # times that the null space is found again at the solution (computing)
    null_space_passes: int = 3
    # directions that poses hardly show are fixed if the squares then rise by less than this for
    # each, in those of noise (level)
    hardly_squares: float = 9.0
    # a direction that poses hardly show counts with its size by this part beside those without any
    # effect on them (computing)
    hardly_share: float = 0.5
    same_span: float = 1e-9  # unless its rows are the same within this part (computing)
    # relative changes at which the Gauss-Newton steps that follow converge to the last
    # digit (computing)
    full_precision: float = 1e-13
    polishing_steps: int = 8  # such steps at most (computing)
    shrinks_share: float = 0.5  # each is shorter than this part of the one before (computing)
    # distance from a bound to which a start is moved, in scales (computing)
    inside_scales: float = 1e-3
    # distance from a bound that counts as being on it, in scales (computing)
    near_bound_scales: float = 1e-2
    # smaller over larger size of a cloud of points that lies on a line (computing)
    same_directions: float = 1e-12


@dataclass(frozen=True)
class Records:
    """What a calibration's record lists."""

    # correlation above which a pair of parameters is listed as nearly inseparable (told)
    correlated: float = 0.95
    most_pairs: int = 20  # pairs that are listed (told)
    pool: int = 1000  # poses to choose from for the curve of poses measured (computing)
    # poses chosen at most: more would change no curve that one can see (computing)
    most_chosen: int = 200
    # expected size of a parameter in its scale, which makes information definite before it
    # is full (size)
    possible_scales: float = 30.0
    little_weight: float = 0.5  # a pose with less weight than this is listed in any case (told)
    curve_points: int = 40  # points of the curve of poses measured (computing)


@dataclass(frozen=True)
class Alike:
    """When errors of poses that follow each other in time are alike."""

    least_rows: int = 40  # poses below which nothing is said of it (statistics)
    # probability by chance below which errors that follow each other are alike (level)
    error_rate: float = 1e-3
    # other orders of the poses, in none of which errors may be as much alike (statistics)
    orders: int = 199
    # poses in which the correlation falls to 1/e, of the shortest and the longest tried (size)
    poses: tuple[float, float] = (0.5, 500.0)
    tried: int = 20  # durations, and shares of the variance, that are tried (computing)


GRADES = Grades()
ALIKE = Alike()
CHECKS = Checks()
SPRINGS = Springs()
UNKNOWNS = Unknowns()
GROUPS = Groups()
FIT = Fit()
RECORDS = Records()

#: All of them, by what they decide.
SECTIONS = {
    "grades": GRADES,
    "alike": ALIKE,
    "checks": CHECKS,
    "springs": SPRINGS,
    "unknowns": UNKNOWNS,
    "groups": GROUPS,
    "fit": FIT,
    "records": RECORDS,
}

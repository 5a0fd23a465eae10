"""Every number on which readings, frames, fitted models and their comparison depend, once.

Its source is in brackets: `level`, a probability or odds that were chosen; `statistics`, what
theory says; `size`, what parts of robots and instruments are like; `measured`, what parted right
from wrong on measured robots; `chosen`, a plausible round number, which no study has fixed; `told`,
how much is printed; `computing`, time and rounding alone. Steps and tolerances of an algorithm
stand in its own module, under a comment that ends in `(computing)`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Order:
    """What the order of rows says: time, places, arrivals, paths."""

    # rank correlation with time from which on the order of rows goes with a joint or load (chosen)
    ordered: float = 0.9
    # largest rank correlation with time of a value that is constant in either half of the rows; a
    # correlation counts as part of the largest that its equal values allow, at least this
    # (statistics)
    of_two_halves: float = 0.75**0.5
    # part of the variance of the rank in time that must lie between readings of the same pose and
    # load for these to show time, whatever the order goes with (chosen)
    again_share: float = 0.01
    # moves of a joint from one pose to the next are small below this part of the moves between any
    # two poses: time then goes with the joint's angle, in pieces (chosen)
    small_moves: float = 0.3
    # a joint position or load parts the rows as a time does where this part of the rows before that
    # time lies below it and of those after it above, in the mean of both (chosen)
    parted_share: float = 0.95
    near_rows: int = 15  # rows on either side of such a time that are looked at alone (chosen)
    least_rows: int = 8  # rows below which no order is one (statistics)
    # rows that a joint sorts throughout, while others jump, from which on they are a table and no
    # order of measurement: chance sorts 20 rows once in 1e18 (statistics)
    sorted_rows: int = 20
    # joint positions no farther apart than this are one place: robots come back to a command within
    # a tenth of it, and nothing that an arm errs by differs over it [rad, m] (size)
    one_place: float = 1e-3
    # with more readings than this beside each in the mean, the robot came back to a place only if
    # it moved in between (chosen)
    most_near: int = 30
    stood_still: float = 1e-4  # a joint that turned less has not moved [rad, m] (size)
    # a joint that turned less has not left where its controller had stopped it [rad, m] (size)
    stayed: float = 2e-3
    # part of the configurations that must have a time of their own for times to give an order
    # (chosen)
    own_times_share: float = 0.95
    # directions of arrival of a joint that must be known to call all of them reversed (statistics)
    least_arrivals: int = 30
    nearly_always: float = 0.85  # part of these directions that must be reversed then (chosen)
    # part of the moves of joints that are small in a scan, where time and place go together
    # (chosen)
    scan_share: float = 0.5
    # poses nearer to each other than this part of the spread of all of them are neighbours (chosen)
    neighbours: float = 0.03
    # probability by chance below which rows lie together at one end of a campaign (level)
    end_rate: float = 1e-4
    end_share: float = 1.0 / 3.0  # part of a campaign up to which it is an end (chosen)
    stretches: int = 5  # stretches of a path that are held out (chosen)
    singly_share: float = 0.1  # part of what is held out that goes singly (chosen)
    # part of held-out poses that must have fitted neighbours for them to lie along a path, whatever
    # their order (chosen)
    beside_share: float = 0.5
    # of held-out poses whose neighbours were mostly fitted, fewer than this part count as these
    # (chosen)
    few_share: float = 0.1


@dataclass(frozen=True)
class Readings:
    """What an instrument's readings are worth."""

    # rows from which on a single one can be found to be wrong, four times those that determine
    # frames and targets: of poses (statistics)
    pose_rows: int = 8
    point_rows: int = 12  # of points (statistics)
    distance_rows: int = 24  # of distances, and of campaigns joined (statistics)
    # degrees of freedom below which the scatter of repeats says too little about six components
    # (statistics)
    least_dof: int = 12
    same: float = 1e-9  # repeats that differ by less are one reading copied [m, rad] (size)
    # readings of calibration poses that a search for effects needs where hardly any is a repeat: as
    # many as its blocks (statistics)
    to_search: int = 100
    # least share of repeats among readings with which they judge effects, not blocks (trials)
    repeated_share: float = 0.25
    # an orientation without a stated uncertainty is as certain as targets this far apart make it
    # [m] (size)
    target_spread_m: float = 0.1
    # scatter along one axis of an instrument over that along another from which on it is noise by
    # the axis: of trackers it is less, of cameras ten (size)
    axes_differ: float = 3.0
    as_stated: float = 1.5  # rms of such scatter over the stated one, at most (size)
    of_length: float = 0.01  # a quaternion's length may differ from one by so much (size)
    # balls nearer to one line than this do not show a turn about it [mm] (size)
    collinear_mm: float = 1.0


@dataclass(frozen=True)
class Frames:
    """What determines frames, targets and units."""

    # how far from the target an error of orientation counts as the error of position it makes there
    # [m] (size)
    lever_m: float = 0.5
    # and of small arms no further than so many times as far as they reach in the poses (size)
    most_reaches: float = 1.8
    # a set thinner than this part of its length counts as lying on one line (computing)
    in_line: float = 1e-6
    scale_rows: int = 8  # rows below which the scale of a unit is not judged (statistics)
    # rows from which on distances are judged with an unknown target in their equation (statistics)
    rows_for_target: int = 34
    # part of the model's motion that the measurement must explain for a scale to be judged (chosen)
    explained_share: float = 0.5
    # least size of the model's motion for that, of how far the arm reaches in the poses (size)
    least_motion_share: float = 0.03
    # positions whose extent across their line is a smaller part of that along it determine no scale
    # (chosen)
    least_breadth: float = 0.05
    base_poses: int = 3  # poses that are needed to fit a base frame (statistics)
    point_distances: int = 4  # distances that are needed to find a fixed point (statistics)
    # root mean square spread across a line that positions must have to determine a rotation [m]
    # (size)
    least_spread_m: float = 1e-3
    # touches of a sphere within this part of its radius (rms) of one plane are coplanar: they
    # hardly determine how far beyond the plane its centre is (size)
    coplanar: float = 0.05


@dataclass(frozen=True)
class Sizes:
    """Arms on which usual sizes in metres were found."""

    # extent of these arms, from servo arms and small SCARAs to a titan on its rail: of smaller or
    # larger ones, errors and motions are taken to be smaller or larger in proportion [m] (measured)
    extent_m: tuple[float, float] = (0.35, 7.0)


@dataclass(frozen=True)
class BaseMotion:
    """Motions of the base and of the instrument, by targets on the base."""

    # log evidence by which a motion must make the readings more probable [nat] (level)
    needed_nats: float = 5.0
    error_rate: float = 0.01  # probability that any reading of good ones is left out (level)
    # times between readings, over the usual one, that a walk goes by (chosen)
    steps: tuple[float, float] = (0.05, 50.0)
    # sizes of motions over the noise of a reading that are tried, in logarithms (computing)
    sizes: tuple[float, float] = (-9.0, 12.0)
    in_line: float = 0.02  # targets thinner than this part of their length are in line (size)
    # share of the configurations that must show a turn, or a pair, for it to be looked for (chosen)
    mostly_share: float = 0.5
    # products of a configuration's readings worse conditioned than this do not show its motion
    # (computing)
    condition: float = 1e6
    # an instrument nearer to the targets is taken to be this far off, where its turn is judged by
    # their shift [m] (size)
    near_m: float = 1.0


@dataclass(frozen=True)
class Knocks:
    """Targets on the base that were knocked, and wrong readings of them."""

    needed_nats: float = 20.0  # half the gain in squares that a step needs [nat] (level)
    either_side: int = 5  # readings on either side of a step (statistics)
    # another target explains a step as well where it is worse by less than this [nat] (level)
    as_well_nats: float = 12.0
    # a step counts from so many standard deviations of a reading, stated or found, the larger
    # (level)
    least_errors: float = 1.0
    # a reading is expected in the median of so many around it of the same target (chosen)
    around: int = 11
    far_off: float = 8.0  # and is far off it from so many times the usual distance (level)
    # readings further off than this many standard deviations count as this far (statistics)
    far_errors: float = 5.0
    # directions in which the shape follows a target by less than this part of the largest say
    # nothing of it (computing)
    follows_share: float = 1e-3
    # probability that any configuration of good readings is left out (level)
    error_rate: float = 0.01


@dataclass(frozen=True)
class Scatter:
    """How readings scatter, and which of them are wrong."""

    tail: float = 1e-3  # share of undisturbed poses that weigh less than fully (level)
    # probability that any pose is suspected in a campaign without a wrong one (level)
    error_rate: float = 0.01
    # readings for each unknown from which on typical residuals are about as large as their errors
    # (statistics)
    enough: float = 2.0
    # median of the size of a normal deviate, by which scatter is first found (statistics)
    median_size: float = 0.6745
    # probability below the upper end of an interval of 95 % (level)
    below_half_width: float = 0.975
    # probability that any of many right deviates, whatever their tails, is called wrong (level)
    accused_rate: float = 1e-4
    # part of the deviates inside the inner quantile; the ratio of the outer to the inner one shows
    # how heavy the tails are (statistics)
    inner: float = 0.5
    outer: float = 0.95  # part of the deviates inside the outer quantile (statistics)
    # degrees of freedom of Student's distribution from which on it counts as normal (statistics)
    normal_dof: float = 200.0
    # standard errors by which the ratio of quantiles may be larger than it was found (level)
    surely_errors: float = 2.0
    # relative standard error of that ratio, times the root of the number of deviates (statistics)
    error_of_ratio: float = 1.4
    # how far a reading with a gross error is off at least, over the scatter of all its components
    # together: one component may hardly scatter (chosen)
    least_far: float = 3.0
    # another reading confirms one where they differ by less than this part of how far it is off
    # (chosen)
    confirmed_share: float = 0.3
    # scatter is no less than this part of what is stated: rounding is none (size)
    least_stated: float = 1e-3
    # scatters of a distance between two targets beyond which it is another one (level)
    same_distance: float = 5.0
    # distances that scatter by less than this part of what is stated were computed from one pose
    # of a body: targets that are read one by one scatter more (size)
    computed_distance: float = 1e-3


@dataclass(frozen=True)
class Parameters:
    """How large parameters may be, and which are identified."""

    # departures of links and zeros are expected to be at least so large, in scales (size)
    usual_scales: float = 1.0
    # and so many times as large as those that the readings determine (chosen)
    usual_times: float = 2.0
    usual_rounds: int = 50  # steps in which their size is found (computing)
    # what is known to this part of its usual size is known by the readings alone (statistics)
    known_share: float = 0.3
    # standard deviation thought possible of the model's own parameters, in their scale: wide enough
    # to leave every direction that the data determine alone, and to settle those that they do not
    # (size)
    possible_scales: float = 30.0
    windup_rad: float = 3e-2  # standard deviation thought possible of a windup [rad, m] (size)
    cubic: float = 3.0  # standard deviation thought possible of a cubic share (size)
    base: float = 1.0  # the same of motions of base and instrument [m, rad] (size)
    # singular values below this part of the largest belong to directions without any effect: exact
    # null directions come out near 1e-16, the weakest real ones above 1e-6 (computing)
    null_ratio: float = 1e-9
    no_part: float = 1e-6  # part of a parameter in a direction that is none (computing)
    # the same in a direction that poses show worse than what is thought possible of it, beside the
    # part of another parameter that stands for it, each in its scale (chosen)
    hardly_part: float = 0.01
    # a radian of orientation counts as so much of position in the fit of a rigid model [m] (size)
    rigid_lever_m: float = 0.1
    # directions of the link parameters that move measured poses by a smaller part than this of what
    # the strongest does stay as calibrated there (chosen)
    determined_share: float = 1e-3


@dataclass(frozen=True)
class Lack:
    """What a fitted model lacks, by the poses that it was fitted to."""

    groups: int = 10  # groups held out in turn (chosen)
    least_in_group: int = 2  # poses that a group has at least (statistics)
    stretches: int = 5  # stretches of a path that are held out together (chosen)
    most_poses: int = 2000  # poses that are looked at, at most (computing)
    most_places: int = 300  # poses to which their distances are taken, at most (computing)
    steps: int = 6  # steps in which the error grows with the distance from fitted poses (chosen)
    least_errors: int = 12  # errors that each step stands on at least (statistics)
    # of poses held out singly, this part counts as near: those farther from others are few (chosen)
    near_share: float = 0.98
    # two poses whose joints differ by less than this are a pair at one place [rad] (size)
    pair_rad: float = 0.01
    least_pairs: int = 20  # such pairs from which on they determine noise (statistics)
    # rounds in which components are weighted by their noise and by what is lacking (computing)
    rounds: int = 20
    # standard errors by which all components show more than the certain ones where they count
    # alike (level)
    surely: float = 2.0
    # twice the log likelihood ratio above which errors at poses kept apart exceed those promised:
    # 95 % of chi square of one degree of freedom (level)
    beyond_chance: float = 3.84
    # poses whose residual is so many times the usual one count less in the fit of the others
    # (level)
    far: float = 3.0
    median_square: float = 0.4549  # median of the square of a normal deviate (statistics)
    # a joint counts as if it moved the end by this part of what the farthest one does, at least
    # (chosen)
    least_lever_share: float = 0.1
    # along a line of sight one of so many components is measured (statistics)
    components: float = 3.0
    # growth of links that no fit has seen: rms of 12 (steel) to 23 ppm/K (aluminium) [1/K] (size)
    growth_per_K: float = 18e-6
    # within so many standard deviations of its temperatures a fit has seen what they do
    # (statistics)
    usual_temperatures: float = 2.0


@dataclass(frozen=True)
class Angles:
    """At which angles a joint was seen."""

    # an angle was seen if poses lie within this of it: a tenth of the finest waves of a map; for
    # coarser maps the distance grows with the wave [rad] (size)
    within_rad: float = float(np.radians(1.25))
    fine_order: float = 25.0  # finest waves of a map [cycles a turn] (size)
    least_poses: int = 5  # poses that must lie within that distance (statistics)
    # gaps between neighbours, in their mean, that still count as visited: one in 150 is longer
    # (level)
    usual_gaps: float = 5.0
    # however densely a joint was seen, what was fitted holds so much further: twice the reach of a
    # fine wave [rad] (size)
    reach_rad: float = 2.0 * float(np.radians(1.25))
    # a joint is about within the range that it had in a fit up to this part of it beyond (chosen)
    beyond_share: float = 0.1


@dataclass(frozen=True)
class Levels:
    """Joints that stood at few positions only."""

    # positions further apart than this part of a joint's range are of different levels (chosen)
    gap_share: float = 0.02
    width_share: float = 0.1  # part of the range that levels together cover at most (chosen)
    least: int = 3  # levels of which one between others can be held out (statistics)
    poses: int = 4  # poses a level, in the mean, below which positions are scattered (statistics)
    # part of the gap between levels from which on nothing is known of what has no shape: lines of
    # gears repeat within far less (size)
    reach_share: float = 0.1
    # odds of an effect of a position against any other function that has its values at the levels,
    # before held-out levels are looked at (level)
    odds: float = 1.0
    sure_odds: float = 19.0  # odds from which on it is surely there (level)
    # between levels an effect and the function in its place differ by both (statistics)
    of_both: float = 2.0


@dataclass(frozen=True)
class Commands:
    """When a commanded pose is reached."""

    # a pose counts as reached within this; what a search leaves is far less [m, rad] (computing)
    reached: float = 1e-6
    # fewer than six joints cannot turn a frame in all directions: an orientation as near as a
    # calibrated arm comes to one of the arm as designed counts as reached. So does one of any arm
    # where its model falls back [rad] (size)
    near_rad: float = 0.02
    # weight of orientations there: such an arm reaches the position first (chosen)
    attitude_share: float = 1e-3
    # smallest motion of the frame, over the reach of the arm or [rad], for a radian (or the reach)
    # of the joints together, below which a pose is near a singularity (chosen)
    singular: float = 0.005
    # a branch of the arm as designed that is further from the pose is out of its reach [m] (size)
    nearly_m: float = 0.02
    # where a seed was given, its branch is kept although the calibrated arm misses the pose on it
    # by less than this: a command may be a little off, and must not swing the arm round [m, rad]
    # (size)
    kept: float = 2e-3
    # joint positions of neighbouring poses that differ by more are no path [rad] (chosen)
    jump_rad: float = 0.3


@dataclass(frozen=True)
class Lists:
    """Lists of poses that were read wrongly, and files that are none."""

    # a way to read a list (units, convention of orientations) hardly holds where it holds for no
    # more than this part of the rows (chosen)
    few_share: float = 0.1
    # part of the rows for which another way must hold, or the one taken fail (chosen)
    most_share: float = 0.5
    nearly_all_share: float = 0.8  # the same where whole targets are reached (chosen)
    # another way must hold for so many times as many rows as the one taken (chosen)
    times_as_many: float = 2.0
    rows: int = 10  # rows from which on joints that hardly move may be radians (statistics)
    wide_rad: float = 1.0  # as radians, such joints turn by so much at least [rad] (size)
    # seeds further from their targets than this part of the reach contradict them; the message says
    # half of it (chosen)
    far_of_reach: float = 0.5
    # seeds are those of a nominal program: the right reading brings them so much nearer, as medians
    # (chosen)
    nearer_share: float = 0.2
    # seeds may be radians where they are farther from their targets than this part of the reach
    # (chosen)
    near_of_reach: float = 0.05
    # quaternions may be in another order where seeds are turned from their targets by more [rad]
    # (chosen)
    alike_rad: float = float(np.radians(20.0))
    # no covariance has more than this, that of eight thousand parameters: maps of twelve joints,
    # with the finest waves that were ever found, have half of them [byte] (size)
    most_bytes: int = 512_000_000
    # how unlike its transpose a correlation matrix may be (computing)
    symmetric_within: float = 1e-3
    # how far below zero the eigenvalues of one may lie that was solved with directions that the
    # poses hardly identify (computing)
    eigenvalues_above: float = -1e-3
    # products of the axes of a frame or pose may differ from those of a rotation by so much, as the
    # digits of a file make it (computing)
    rotation_within: float = 1e-6


@dataclass(frozen=True)
class Masses:
    """Weights of the arm and of the tool, as stated and as torques have them."""

    # mass of an arm of 1 m [kg], and the power of the length with which arms weigh: a UR10 of 1.7 m
    # 29 kg, an MA2010 of 2.8 m 260 kg, a KR 1000 titan of 5.1 m 4690 kg, by their makers' data
    # sheets; beyond the largest usual extent they weigh as they are long (size)
    kg_at_1_m: float = 15.0
    length_power: float = 3.0  # the power just said (size)
    # drives and flanges weigh as if every link were longer by this part of the arm (size)
    drives_share: float = 0.1
    # relative standard uncertainty of an assumed mass without a known total (size)
    u_mass: float = 1.0
    u_mass_of_total: float = 0.5  # the same with a known total (size)
    # standard uncertainty of an assumed centre of mass along each axis, of the length that a link
    # weighs by (size)
    centre_share: float = 0.3
    # masses that a drawing program exports where nobody gave any [kg] (size)
    placeholders_kg: tuple[float, float] = (0.0, 1.0)
    # a total that differs by more from the sum of the parts contradicts them (size)
    total_off_share: float = 0.25
    gain: float = 0.05  # scale of a joint's logged torque that may be (size)
    # gain of a joint's logged torque below which a log is right: loads and lengths are stated to
    # about as much (size)
    least_gain: float = 0.02
    # how far off a joint of an arm that is not calibrated yet may be mastered, or turned by its
    # load: marks are set by eye to a degree [rad] (size)
    mastered_rad: float = 0.02
    friction_share: float = 0.03  # friction that may be, of its rated torque (size)
    zero_share: float = 0.01  # zero that may be, of its rated torque (size)
    # friction from which on a log is of a motor, and it is taken out, of its rated torque: sensors
    # at the joints of an iiwa 7 and of Justin show 0.003 at the most, motors 0.015 to 0.05
    # (measured)
    friction_of_motor: float = 0.01
    # part of the readings that repeat others from which on friction is sought as an effect (size)
    repeated_share: float = 0.25
    # how far weights of any kind may be from their usual size, in that (computing)
    any_sizes: float = 1e3
    # a link is stated wrongly where logged torques want it other than stated by so many standard
    # uncertainties (level)
    off_errors: float = 5.0
    # and explain them better than chance or another cause allows, by so much log evidence [nat]
    # (level)
    needed_nats: float = 12.0
    # a wrong tool is told beside a wrong link where torques are explained by either to so much log
    # evidence [nat] (level)
    alike_nats: float = 3.0
    # a mass is contradicted by so many standard uncertainties of what is stated and logged
    # together; a zero of logged torques is shown by so many of its own (level)
    differs_errors: float = 4.0
    # scatter about weights of any kind, of the torques logged, above which those are not of weights
    # (chosen)
    scatter_share: float = 0.3
    # correlation of logged with calculated torques below which their signs or gravity are off
    # (chosen)
    follows: float = 0.8
    # least torques a fitted column with which their scatter is their noise (statistics)
    torques_a_weight: int = 2
    # residuals that are so many times smaller than the noise of readings and the scatter of torques
    # make them: a part of that scatter is of forces (trials)
    forces_ratio: float = 3.0
    # torques are resolved to no better than this part of the largest (size)
    resolved_share: float = 1e-4
    # a joint's scatter, and the size of a weight of any kind, are no less than this part of the
    # largest (computing)
    least_of_largest: float = 1e-3
    # a reading with a gross error weighs no more than one so many times the scatter off (level)
    edge: float = 4.0
    # a link weighs at least this part of what is described or assumed (size)
    least_share: float = 1e-3
    least_drawn_share: float = 0.01  # the same where weights of a fit are taken over (size)
    most_poses: int = 400  # poses that are looked at, spread over all (computing)
    # standard uncertainty of the mass of a tool that is stated, relative (size)
    tool_share: float = 0.12
    tool_com_m: float = 0.02  # standard uncertainty of its centre of mass, per axis [m] (size)
    unknown_tool_share: float = 0.1  # mass of an unknown tool, as part of the arm's (size)
    unknown_tool_com_m: float = 0.1  # distance of its centre from the flange [m] (size)
    # standard uncertainty of the direction of gravity in the base frame [rad] (size)
    level_rad: float = 1e-3
    # the same of an arm of which no weights are stated: nobody levelled it for them [rad] (size)
    level_assumed_rad: float = 5e-3


@dataclass(frozen=True)
class Moved:
    """What moved between two campaigns."""

    error_rate: float = 0.01  # probability allowed of a name where nothing moved (level)
    # sizes that a change is tried with, in tolerances of the parameter; of a stiffness in
    # `softer_share` (size)
    sizes: tuple[float, float] = (1.0, 10.0)
    softer_share: float = 0.3  # a change of stiffness, as part of the windup (size)
    # an arm whose model lacks something departs by more than its noise, by such factors of variance
    # (size)
    factors: tuple[float, ...] = (3.0, 10.0, 30.0, 100.0, 300.0, 1000.0, 3000.0)
    # probability that the zero of some joint moved: a crash loses zeros (level)
    zero_moved: float = 0.05
    other_moved: float = 0.005  # probability that something else did (level)
    # by which factors noise may be larger than expected (size)
    louder: tuple[float, ...] = (1.0, 1.5, 2.2, 3.3, 5.0, 8.0, 12.0)
    louder_power: float = 8.0  # how fast that gets less likely (level)
    axes: float = 3.0  # axes of a position error (statistics)
    # readings that each further departure takes at least, beyond two (statistics)
    readings_each: int = 3
    # what a frame may have moved by [mm, mrad] (size)
    motions: tuple[float, ...] = (1.0, 10.0, 100.0, 1000.0)
    # a parameter whose differences are expected to be larger than this many scales is not
    # identified (chosen)
    open_scales: float = 15.0
    # a hypothesis is an alternative where its evidence is lower by less than the logarithm of the
    # number of hypotheses over this (level)
    listed: float = 0.03


@dataclass(frozen=True)
class Compared:
    """Models compared with each other and with held-out poses."""

    # models are said to differ where chance leaves so much in fewer than one of a hundred pairs
    # (level)
    least_chance: float = 0.01
    # nominal rows closer than this are the same: a file may have been written with 12 digits [m,
    # rad] (computing)
    same: float = 1e-9
    # terms of more parameters are curves, which a figure of their own shows (told)
    most_parameters: int = 24
    # a carried model with errors larger than those of the nominal arm by this factor is worse
    # (chosen)
    worse_ratio: float = 1.02
    most_points: int = 500  # more points than this are listed pose by pose only (told)
    # calibration poses of a part from which on it has its own base (statistics)
    own_base_poses: int = 10
    own_base_components: int = 30  # and components seen in them (statistics)
    # unknowns of base and tool that were fitted to the poses: so many degrees of freedom less
    # (statistics)
    of_frames: int = 12
    # repeats of a configuration below which its scatter says too little; the standard has 30
    # (statistics)
    least_repeats: int = 5


@dataclass(frozen=True)
class Stands:
    """Readings that were repeated while the arm stood still."""

    # pairs of successive ones below which their scatter says too little (statistics)
    least_pairs: int = 20
    # stated uncertainty over their scatter above which it holds what the instrument errs by in all
    # of them; the same ratio of other repeats is a mistake (measured)
    stated_ratio: float = 3.0
    # stated uncertainties by which one is off the median of three or more to be left out (level)
    off_errors: float = 5.0
    least_for_median: int = 3  # readings of a stand whose median tells which is off (statistics)


ORDER = Order()
READINGS = Readings()
FRAMES = Frames()
SIZES = Sizes()
BASE_MOTION = BaseMotion()
KNOCKS = Knocks()
SCATTER = Scatter()
PARAMETERS = Parameters()
LACK = Lack()
ANGLES = Angles()
LEVELS = Levels()
COMMANDS = Commands()
LISTS = Lists()
MASSES = Masses()
MOVED = Moved()
COMPARED = Compared()
STANDS = Stands()

#: All of them, by what they decide.
SECTIONS = {
    "order": ORDER,
    "readings": READINGS,
    "frames": FRAMES,
    "sizes": SIZES,
    "base_motion": BASE_MOTION,
    "knocks": KNOCKS,
    "scatter": SCATTER,
    "parameters": PARAMETERS,
    "lack": LACK,
    "angles": ANGLES,
    "levels": LEVELS,
    "commands": COMMANDS,
    "lists": LISTS,
    "masses": MASSES,
    "moved": MOVED,
    "compared": COMPARED,
    "stands": STANDS,
}

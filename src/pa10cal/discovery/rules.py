"""Numbers on which verdicts depend, but for `tuning`: what each bounds, its unit and source.

The source is in brackets: `level`, a probability or odds that were chosen; `statistics`, what
theory says; `size`, what parts of robots and instruments are like; `trials`, what parted right from
wrong on simulated campaigns, which no measured robot has fixed; `measured`, what did so on measured
robots; `chosen`, a plausible round number, which no study on record has fixed; `vocabulary`, which
effects there are; `safety`, room for the arm; `told`, how much is printed; `computing`, time and
rounding alone.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from pydantic import JsonValue
from pydantic_core import to_jsonable_python
from scipy.special import ndtri

from pa10cal.discovery.tuning import COMPUTING, FIELD, FORMS, NEXT_POSES, PLACES, SESSIONS
from pa10cal.results.number_text import SURE

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


@dataclass(frozen=True)
class Noise:
    """Noise of readings, from repeats or else from poses near each other."""

    least_differences: int = 20  # least differences of repeats that show the noise (statistics)
    # least share of repeats among the readings with which repeats judge, where blocks could be held
    # out instead (trials)
    least_repeated_share: float = 0.25
    least_left_share: float = 0.5  # least degrees of freedom of residuals, of readings (chosen)
    # ratio of repeats from any side to those from one side from which on all are compared (trials)
    any_side_ratio: float = 2.0
    same_pose: float = 2e-3  # poses nearer than this in every joint count as one [rad, m] (size)
    # largest distance of pairs in the variogram whose nugget is the noise [rad, m] (Cressie,
    # Statistics for Spatial Data, 1993)
    near_pose: float = 0.01
    near_steps: int = 5  # steps of distance of that variogram (computing)
    most_neighbours: int = 8  # neighbours of a pose in that variogram (computing)
    # scatter of a torque, in the largest one, that rounding alone makes (size)
    rounded_torque_share: float = 1e-6
    reweighted: int = 2  # rounds in which scatter and weights are estimated in turn (computing)
    median_to_sigma: float = 1.0 / float(ndtri(0.75))  # of normal deviates (statistics)
    huber_tail: float = 1e-3  # share of undisturbed poses that weigh less than fully (level)
    least_shrink: float = 1e-3  # least factor by which stated uncertainties are reduced (size)
    enough_poses: int = 1500  # poses that suffice for the scatter of joints (computing)
    variances: tuple[float, float] = (1e-14, 1e-4)  # bounds of these variances [rad², m²] (size)
    first_variance: float = 1e-9  # start of the variance of a joint [rad²] (computing)


@dataclass(frozen=True)
class Judging:
    """Which campaigns can be judged, and what is no effect of all poses."""

    # least components of different poses a parameter, where repeats judge (trials)
    rows_an_unknown: float = 1.25
    # typical error from which on orientations are not those of the arm [rad] (size)
    no_attitude_rad: float = 0.05
    # most poses that are excluded because a name rests on them alone (trials)
    most_carriers: int = 3
    # a name rests on one pose if less than this part of its evidence remains without it (trials)
    carried_share: float = 0.5
    identified_share: float = 1.0 / 3.0  # largest u of what is identified, in its size (trials)
    gap_level: float = 0.95  # probability of the interval of the gap's reduction (level)
    # errors over noise from which on something is missing, where nothing was found (trials)
    more_than_noise: float = 1.15


@dataclass(frozen=True)
class Candidates:
    """Which effects of the vocabulary the poses can show."""

    # least part of an effect that the model's own parameters cannot follow (trials)
    least_share: float = 0.02
    # the same of an effect whose part is clear: much less is imitated by wrong geometry (trials)
    clear_share: float = 0.005
    clear_signal: float = 40.0  # such a part at plausible size [standard deviations] (trials)
    # least size of that part, for the largest plausible effect [standard deviations] (statistics)
    least_signal: float = 4.0
    largest_sizes: float = 10.0  # largest plausible size over the usual one (size)
    sizes_of_time: float = 3.0  # prior size of effects of time, in plausible sizes (trials)
    # highest wave of a joint's error that motion in time has to beat where poses are read once; and
    # of a joint that moves slowly [cycles a turn] (trials)
    waves: tuple[int, int] = (8, 24)
    wave_rad: float = 3e-4  # their prior size [rad] (size)
    named_orders: int = 2  # highest order that has a name of its own (vocabulary)
    near_order: float = 0.5  # distance of other such orders from twice the gear ratio (vocabulary)
    apparatus_m: float = 5e-6  # standard uncertainty of an apparatus' targets, an axis [m] (size)
    lifts_share: float = 0.1  # least torque of a joint that lifts the arm, of the largest (size)


@dataclass(frozen=True)
class Evidence:
    """Effects where repeats judge: by evidence, confirmed by sign flips over poses."""

    # most readings of a cell: a drift is seen between the cells of a longer row of repeats (trials)
    readings_a_cell: int = 4
    # prior sizes of an effect that are tried, in its plausible size (size)
    sizes: tuple[float, ...] = (0.1, 1.0, 10.0)
    usual_size: int = 1  # index of the size that is tried first (size)
    # cosine from which on two effects are indistinguishable (statistics)
    indistinguishable: float = 0.999
    # least gain of a forward step, which may be a proxy for a later one [nat] (trials)
    forward_nats: float = 1.0
    most_effects: int = 10  # most effects of a set (trials)
    most_rounds: int = 6  # rounds of steps forward and back (computing)
    rounds_of_time: int = 2  # rounds in which motion and noise are estimated in turn (computing)
    rounds_of_sizes: int = 4  # rounds in which sizes and fit are found in turn (computing)
    flips: int = 999  # random sign flips (computing)
    flips_seed: int = 20080427  # their random seed (computing)
    false_rate: float = 0.05  # probability that any candidate gains as much by chance (level)
    folds: int = 9  # blocks of poses held out in turn besides (computing)
    # probability allowed that the truth is missing among an effect and its alternatives (level)
    missed_rate: float = 0.03
    # odds of a name against the map of its joint from which on the map is no alternative (level)
    odds_over_map: float = 20.0
    # error of linear evidence that is allowed for in the choice of rivals to refit [nat] (trials)
    refit_margin_nats: float = 4.0
    most_refits: int = 12  # rivals that are refitted (computing)
    # lowest, highest and number of variances tried of the error that readings of a pose share, in
    # those of a reading; zero is tried, too (size)
    pose_variances: tuple[float, float, int] = (1e-2, 1e5, 15)
    # variances interpolated between the neighbours of the best one (computing)
    variances_between: int = 129
    form_folds: int = 9  # blocks of poses held out in turn for short forms (computing)
    least_uncertainty_share: float = 0.1  # least standard uncertainty over the stated one (size)


@dataclass(frozen=True)
class Blocks:
    """Effects where poses are read once: blocks of poses are held out in turn."""

    blocks: int = 10  # blocks of poses (trials)
    least_poses: int = 10  # least poses of a block (statistics)
    # components of poses that show their six motions by more than these, as three targets do, and
    # the least poses of a block then (trials)
    sure_poses: tuple[int, int] = (9, 7)
    # poses of the last block outside the joint positions of all others, from which they are dealt
    # to all blocks; ranges of six joints have one or two of them by chance (statistics)
    least_apart: int = 5
    standard_errors: float = 3.0  # least gain of an effect, in standard errors over blocks (level)
    # least gain of an effect, as part of the remaining error over the noise (trials)
    least_share: float = 0.05
    one_sided_deviates: float = 1.645  # 95 % quantile of the normal distribution (statistics)
    most_rounds: int = 3  # rounds of the search (computing)
    most_exchanges: int = 5  # names exchanged in a round (computing)
    most_names: int = 4  # names tried at one place (trials)
    # most that all names of a place together may be worse than a map, in standard errors (level)
    hopeless_errors: float = 3.0
    # most that positions or orientations may lose by an effect, in standard errors (level)
    worse_errors: float = 2.0
    # most that one kind may lose by an arrival error, as part of the gain of both (trials)
    most_lost_share: float = 0.1
    # error of held-out blocks over what noise and uncertain parameters give, above which the model
    # lacks something (trials)
    over_expected: float = 1.12
    over_expected_errors: float = 3.0  # standard errors over blocks by which it must be (level)
    # standard error of the median of normal deviates over that of the mean (statistics)
    median_errors: float = 1.2533
    # largest part of the squared error that parameters take up by chance (statistics)
    most_by_chance: float = 0.9
    chance_shares: float = 2.0  # factor on the share of a parameter in that (chosen)
    lag_rad: float = 1e-4  # expected lag of orientations [rad] (size)
    told_share: float = 0.5  # lags are reported from this part of the largest one on (trials)
    # rows of zeros are removed if less than this part of the rows was seen (computing)
    seen_share: float = 0.75
    # prior size of weights whose prior is among the rows already (computing)
    sizes_not_twice: float = 100.0
    directions: int = 1000  # random directions of an effect's parameters (computing)
    hidden_share: float = 0.05  # part of these in which it may be hidden (level)
    drift_waves: int = 6  # cosines along each axis of a slow drift (trials)
    # part of a target's prior variance from which on its coordinate is not determined (statistics)
    open_share: float = 0.25
    # least part of the readings with different times, for a slow drift (trials)
    own_times_share: float = 0.95


@dataclass(frozen=True)
class Maps:
    """Errors of a joint by its angle: knots, smoothness, bands of waves, maps compared."""

    # knots a turn of maps tried, with the order at which half as much is expected (trials)
    spacings: tuple[tuple[int, float], ...] = ((36, 4.0), (72, 10.0), (144, 25.0))
    sizes_rad: tuple[float, ...] = (3e-5, 1e-4, 3e-4)  # sizes of maps tried [rad] (size)
    fine_knots: int = 72  # knots a turn of a map that follows ten waves and more (size)
    # knots a turn tried once it is known which joints have a map (trials)
    finer_knots: tuple[int, ...] = (216, 360)
    # least angles of a joint for each freedom of a map over their range, on a grid (statistics)
    angles_a_freedom: float = 1.5
    weighing_knots: int = 72  # knots of the maps by which poses are weighed (computing)
    # their size and the order at which half as much is expected [rad] (size)
    weighing_prior: tuple[float, float] = (1e-4, 10.0)
    reweighted: int = 2  # times that poses are weighed anew (computing)
    # part of the readings that a fit may take up: beyond, little is left of the noise (statistics)
    most_taken_share: float = 0.6
    # highest order that decides about a spectrum, in cycles a turn: beyond is the floor (trials)
    highest_band: int = 107
    angle_parts: int = 10  # parts of a joint's visited angles, alike in poses (computing)
    # stretches of angles that are left out, of all joints together, or all parts of few joints: six
    # told by chance which of two priors is better (measured)
    angle_stretches: int = 20
    # weights of orientations that are tried, in their scatter (trials)
    attitude_weights: tuple[float, ...] = (1.0, 0.5, 0.25)
    # how far the logarithms of a band's numbers may be off usual ones, a standard deviation (size)
    band_std: tuple[float, ...] = (1.0, 1.0, 1.0, 0.5, 0.5, 0.5, 1.0)
    # how far those of a joint may be off the arm's (size)
    band_std_of_joint: tuple[float, ...] = (0.5, 0.4, 0.3, 0.2, 0.15, 0.2, 0.6)
    angles_a_turn: int = 360  # angles at which errors of two campaigns are compared (computing)
    compared_poses: int = 10  # poses near an angle by which a campaign visited it (trials)
    compared_within_deg: float = 1.5  # so near [deg] (trials)
    compared_arc_lengths: float = 2.0  # correlation lengths of curves in an arc left out (trials)
    compared_arcs: int = 8  # arcs without which there is no interval (statistics)


@dataclass(frozen=True)
class Names:
    """When an effect that was found is named."""

    most_sizes: float = 10.0  # most plausible sizes of the parameters of a named effect (size)
    # level of the confidence region of its parameters, which must not contain zero (level)
    confidence: float = 0.95
    most_alternatives: int = 6  # most alternatives of a named effect (trials)
    # factor within which errors, repeatability and stated uncertainty agree (trials)
    agree_ratio: float = 3.0
    # lack of fit F of torques that is none: 0.8 to 1.1; 1.6 if one load of three is off (trials)
    most_torque_ratio: float = 1.3
    torque_p_value: float = 1e-6  # and its largest p value (level)
    # largest part of the error that other weights leave for them to be reported (trials)
    most_left_share: float = 0.9
    # standard errors by which a weight differs from a statement that is told as wrong (level)
    statement_errors: float = 3.0
    # factor from which on larger held-out errors are worse, significant or not (trials)
    worse_ratio: float = 1.02
    likelier: float = 2.0  # odds against a name from which on a rival replaces it (level)
    as_likely: float = 0.99  # odds from which on a rival cannot be told from a name (computing)
    much_worse_ratio: float = 1.05  # factor from which on they speak against a name (trials)
    # factor up to which larger held-out errors do not count, even if significant (trials)
    trifling_ratio: float = 1.005
    # ratio of held-out errors to noise and model uncertainty that contradicts a name (trials)
    contradicted_ratio: float = 1.5


@dataclass(frozen=True)
class Probabilities:
    """How probable a name is, among all effects that were tried in its place."""

    # divisor of scores by blocks of poses, as errors of poses are correlated (trials)
    blocks: float = 3.0
    draws: int = 1000  # draws of the weights of blocks (computing)
    # prior odds of maps and smooth functions against a name, which they can imitate, where blocks
    # judge (level)
    flexible: float = 1.0 / Evidence.odds_over_map
    # probability from which on predictions hold another explanation of the readings (level)
    other_readings: float = 0.25
    pull: float = 0.3  # prior odds of a pull at a joint against its gear ratio (trials)
    second: float = 0.05  # odds of two errors of the same joint's angle against one cause (level)
    one_curve: float = 1.0  # odds of a curve without a name against two causes at a joint (trials)
    unknown: float = 0.01  # probability that no effect that was tried is present (trials)
    # the same where more than noise is left without a name, or something stiffens (trials)
    unknown_beside: float = 0.17
    # probability, of touches, that a log of another instant is a machine that reads by the side
    # from which it comes: both follow the move to the pose, and no such error is tried (chosen)
    machine_reverses: float = 0.25
    usual_sizes: float = 2.0  # plausible sizes from which on odds of something else grow (size)
    # power by which they grow: an encoder 2.4 mrad off its centre was a counterbalance (trials)
    size_power: float = 3.0
    # where blocks judge: odds of an effect that removes as much of the squared error as remains,
    # the power of that ratio in these, and that of remaining error over noise (trials)
    known_effect: tuple[float, float, float] = (7.0, 0.2, 0.5)
    known_sag: tuple[float, float] = (1.3, 1.0)  # the same of a joint that gives way (trials)
    left_of_noise: float = 0.01  # least remaining squares, as part of those of noise (computing)
    # ratio of remaining error to noise from which on odds are the same (trials)
    most_left_of_noise: float = 3.0
    # probability of none of these from which an effect has no name, and least of a fault (level)
    nameless: float = 0.5
    surely: float = SURE  # probability of the set that contains the truth (level)
    least: float = 0.01  # probability from which an alternative is listed (level)


@dataclass(frozen=True)
class Motion:
    """Motion of base or instrument in time: walks, jumps, drifts."""

    # lowest, highest and number of root mean squares of a walk tried [m] (size)
    walks_m: tuple[float, float, int] = (3e-6, 3e-3, 9)
    # standard deviations of a jump tried [m] (size)
    jumps_m: tuple[float, ...] = (3e-5, 3e-4, 3e-3)
    # expected turns over shifts that are tried [rad/m] (size)
    turns_rad_per_m: tuple[float, ...] = (0.0, 1.0)
    # prior sizes of effects that are tried besides, in plausible sizes (size)
    effect_sizes: tuple[float, ...] = (0.1, 1.0, 3.0)
    pose_variances: tuple[float, float, int] = (0.1, 1e4, 7)  # as `Evidence.pose_variances` (size)
    false_rate: float = 1e-3  # probability allowed of seeing a motion where there is none (level)
    most_jumps: int = 4  # jumps that may be found (trials)
    least_side: int = 4  # readings on either side of a jump (statistics)
    coarse_times: int = 40  # times of a jump first scanned (computing)
    # least root mean square of a motion over the noise of one reading (trials)
    least_noise_ratio: float = 0.5
    # least covariance of errors of single targets over that of their common motion, a degree of
    # freedom, for which that is no motion: of independent errors it is 1 (statistics)
    single_share: float = 0.5
    single_errors: float = 4.0  # and by how many standard errors it is not zero (level)
    # least noise over that by which rows are whitened: more columns than rows could explain all of
    # it (trials)
    least_noise_share: float = 0.3
    as_good_nats: float = 3.0  # most that another possible time of a jump is worse [nat] (level)
    # least length of a pause, in the usual time between readings (trials)
    pause_ratio: float = 30.0
    pause_s: float = 600.0  # least length of a pause [s] (size)
    # least evidence of a drift between the readings of a pose [nat] (level)
    drift_nats: float = 5.0
    by_load_m: float = 1e-3  # expected motion of the base between loads [m, rad] (size)
    targets_m: float = 3e-2  # prior size of errors of fitted targets [m] (size)
    most_readings: int = 1200  # most readings used, spread evenly over time (computing)
    walk_waves: int = 16  # waves of a walk over the campaign, with 96 % of its variance (computing)
    # waves of the base by the positions of a joint that the order of rows follows (trials)
    rival_waves: int = 8
    rival_m: float = 1e-3  # their size [m] (size)
    # rounds in which motion is compared with errors of further joints (computing)
    most_rivals: int = 4


@dataclass(frozen=True)
class Change:
    """Changes at a row: a target slipped, another reflector, another model in the log."""

    size: float = 1e-3  # unit of the size of a change [m, rad] (size)
    scales: tuple[float, ...] = (0.1, 0.3, 1.0, 3.0, 10.0)  # sizes tried, in that unit (size)
    # prior size of parameters that were fitted to readings before and after, in usual sizes (size)
    static_sizes: float = 10.0
    frames: float = 3e-3  # expected difference of base and targets of another model [m, rad] (size)
    # least share of the squares that a change leaves: rows are no more linear than that (computing)
    same_squares: float = 1e-3
    least_side: int = 10  # readings on either side (statistics)
    # poses measured on both sides, with one load, that show a step whatever else changed with it
    # (statistics)
    least_across: int = 5
    false_rate: float = 1e-3  # probability allowed of seeing a change where there is none (level)
    better_nats: float = 9.0  # least evidence of a change against a step of the base [nat] (trials)
    # most that another kind of change is worse to be a rival [nat] (level)
    as_good_nats: float = 3.0
    # largest part of the squared error that it leaves: any step leaves a little less (trials)
    most_left_share: float = 0.5
    most_left_beyond: float = 0.25  # or of that beyond the stated noise (trials)
    least_noise_ratio: float = 0.5  # least size over the stated noise of a reading (trials)
    courses: int = 3  # powers of time of the gradual courses that it must beat (trials)
    # times in which the zero of a joint may settle, over that of the campaign (size)
    settling: tuple[float, ...] = (0.02, 0.06, 0.2)
    row_nats: float = 3.0  # most that another possible row is worse [nat] (level)


@dataclass(frozen=True)
class Loose:
    """A target that is loose on the tool."""

    targets: int = 3  # of fewer it cannot be told which one moves (statistics)
    least_poses: int = 20  # poses that show the distance between two (statistics)
    # scatter of a distance over the noise from which on a target moves; no target of six measured
    # robots comes near (measured)
    ratio: float = 1.5
    standard_errors: float = 3.0  # and surely so, by these errors of its estimate (level)
    # standard error of a standard deviation by the median absolute deviation, times the root of the
    # number of normal deviates (statistics)
    median_errors: float = 1.166


@dataclass(frozen=True)
class Springs:
    """Joints that give way."""

    # least deflection at the largest torque of a joint that is named [rad] (size)
    least_rad: float = 1e-6
    stretches: int = 40  # stretches of time whose poses may have correlated errors (trials)
    stretch_poses: int = 4  # least poses of a stretch (statistics)


@dataclass(frozen=True)
class Together:
    """Sets of effects under weights that are not stated."""

    # prior size of compliances, in plausible sizes, as assumed weights are uncertain (trials)
    sizes: float = 3.0
    # standard uncertainties by which an amount that cannot be negative may be below zero (level)
    below_zero: float = 2.0
    most_poses: int = 2000  # most poses used (computing)
    steps: int = 10  # Gauss-Newton steps to the amounts and weights of a set (computing)
    steps_beside: int = 2  # the same from a set that differs by one member (computing)
    # change of amounts, in their sizes, and of nats, at which steps end (computing)
    settled: float = 1e-3
    looked_at: int = 5  # most promising sets that are scored exactly (computing)
    near_nats: float = 5.0  # most that a rival is worse to be scored exactly [nat] (computing)
    begun_with: int = 5  # likeliest single members from which searches start (computing)
    # least squares that a combination of weights changes, in those of noise (computing)
    least_squares: float = 0.01
    # eigenvalues of products that are rounding, over the largest (computing)
    rounding: float = 1e-12


@dataclass(frozen=True)
class Torques:
    """Faults of logged torques."""

    fault_nats: float = 6.9  # least gain of a fault: odds of 1000 to 1 [nat] (level)
    half_squares: float = 4.0  # least decrease of squares of either half, in those of noise (level)
    least_sizes: float = 0.3  # least size, in its plausible size (trials)
    reweighted: int = 5  # rounds in which scatter and fit are found in turn (computing)
    least_noise_Nm: float = 1e-9  # least noise of a torque [N m] (computing)


@dataclass(frozen=True)
class Rows:
    """Faults of single rows: gross errors, exchanged labels, slips of a load."""

    # largest part of a residual that another order of exchanged labels leaves (trials)
    exchanged_left_share: float = 0.25
    most_targets: int = 5  # most targets of which every order is tried (computing)
    # probability that any reading is excluded where none is wrong and errors are normal (level)
    excluded_rate: float = 0.1
    # components of a reading below which a joint explains any deviation of it (statistics)
    least_components: int = 3
    # readings before and after a reading: if most of them are off as well, it is no gross error
    # (trials)
    neighbours: int = 5
    # relative error of a scatter found from one deviate by its median, twice (statistics)
    scale_error: float = 2.3
    # probability allowed of a gross error in any mean of a pose, whose tails are light (level)
    of_poses_rate: float = 1e-3
    # standard errors by which their tails may be heavier than found (level)
    of_poses_errors: float = 1.6
    most_beyond_share: float = 0.1  # largest share of readings that are gross errors (trials)
    # least readings that are off by one joint, and so no gross errors (trials)
    least_of_a_joint: int = 5
    of_a_joint_share: float = 0.95  # least part of their squares that this joint explains (trials)
    of_a_joint_times: float = 3.0  # largest of these over their median (trials)
    least_noise_share: float = 0.1  # least scatter over the noise found (size)
    median_readings: int = 11  # readings of a running median (computing)
    # most that the load shown differs from the other load, over the difference of both (trials)
    near_load_share: float = 0.25
    load_known_times: float = 3.0  # that difference over the uncertainty of the load shown (level)
    load_errors: float = 8.0  # distance from the stated load, in uncertainties (level)
    # largest part of the squared error that the other load leaves (trials)
    load_left_share: float = 0.25
    most_slips_share: float = 0.1  # largest share of readings with an exchanged load (trials)
    most_slipped_poses: float = 0.25  # and of poses; above both a load or torque is wrong (size)


@dataclass(frozen=True)
class Lines:
    """Lines of gears whose ratio is not stated."""

    # lowest and highest cycles a turn: below are errors by the joint's angle, that maps follow;
    # above is twice the ratio of any gear but a few (size)
    orders: tuple[float, float] = (13.0, 360.0)
    # lowest in place of a map of a joint that was not seen all around: lower have names (size)
    lowest_in_map: float = 3.0
    # cycles over the range of its angles: fewer are a smooth error (statistics)
    least_cycles: float = 1.0
    size_rad: float = 1e-4  # size of a line by which it is sought [rad] (size)
    widths_apart: float = 2.0  # widths within which numbers of cycles are one line (statistics)
    better_nats: float = 4.6  # nats by which the best must stand out of others further away (level)
    # times that the best must gain of any other in place of a map: many orders are no line (level)
    of_map_times: float = 2.0
    angle_decimals: int = 4  # of angles [rad] that are different (size)
    step_widths: float = 0.5  # steps by which lines are sought, in widths (computing)
    order_decimals: int = 3  # of cycles a turn, as a line is known by (told)
    least_angles: int = 50  # different angles of a joint below which no line is sought (statistics)
    most_poses: int = 2000  # poses that say enough of where lines are (computing)
    at_once: int = 100  # numbers of cycles that are computed together (computing)
    most_multiple: int = 5  # highest multiple of k at which a line that is no sine is tried (size)
    most_rounds: int = 3  # times that lines are sought anew, beside those found (computing)


@dataclass(frozen=True)
class Wobbles:
    """Axes that wobble, more than any compliance under the weights can explain."""

    # plausible sizes by which bearings, links and base may give way, about any axes (trials)
    sizes: float = 10.0
    better_nats: float = 4.6  # nats by which that of one joint must stand out of any other (level)


@dataclass(frozen=True)
class WarmingUp:
    """Joints and links that warm up in the first poses."""

    # shortest time constant [s], longest one in the campaign, and their number: castings and the
    # grease of gears take minutes to hours (size)
    time_constants: tuple[float, float, int] = (300.0, 0.2, 24)
    base_m: float = 1e-4  # plausible motion of base, tool and targets [m, rad] (size)
    better_nats: float = 4.6  # nats by which it must stand out of a base or tool that moves (level)


@dataclass(frozen=True)
class Ripple:
    """The motor's ripple in residuals of joints, which distinguishes sensors and gears."""

    false_rate: float = 0.01  # probability allowed of one false line in a whole search (level)
    most_orders: int = 40  # multiples of the gear ratio at which lines are sought (trials)
    ratios: tuple[float, float] = (30.0, 260.0)  # gear ratios thought possible (size)
    least_poses: int = 100  # poses that a joint must have moved to (trials)
    # turns over which poses are gridded: orders go in steps of a quarter (computing)
    grid_turns: int = 4
    grid_cells: int = 2**17  # cells of that grid (computing)
    # lowest and highest order sought: below are the joint's own errors by its angle (size)
    orders: tuple[int, int] = (40, 4096)
    # shares of the error with which lines are sought (computing)
    error_shares: tuple[float, ...] = (0.0, 0.5, 1.0, 1.5)
    # lowest, highest and number of shares between which the best one is (computing)
    share_grid: tuple[float, float, int] = (-0.5, 2.0, 51)
    # turn of the motor by a torque of one standard deviation, at most [rad] (size)
    most_turn_rad: float = 1e-3
    phase_step_rad: float = 0.25  # its steps, in phase of the highest line [rad] (computing)
    # phase by which the joint's error must turn the highest line for it to say anything [rad]
    # (trials)
    least_turn_rad: float = 0.25
    # steps of order over which the background of a spectrum is taken (computing)
    background_steps: int = 2048
    most_lines: int = 12  # lines that are looked at (computing)
    same_order: float = 0.5  # lines this near are one [cycles a turn] (computing)
    # lines this near to a power of two are of a sensor's divisions [cycles a turn] (chosen)
    of_a_division: float = 1.0
    # at a multiple k of a ratio they are k times as near [cycles a turn] (computing)
    same_ratio: float = 0.02
    ratio_step: float = 0.04  # steps of ratio tried for the greatest common divisor (computing)
    # part of the larger of two ratios by which one may miss a multiple of the other (trials)
    commensurate_share: float = 0.01
    # half of what twice the log-likelihood may fall within a 95 % interval (statistics)
    half_chi2_95: float = 1.92
    joint_rad: float = 5e-5  # scatter of a joint's angle to begin with [rad] (computing)
    variance_rounds: int = 20  # rounds in which variances are found (computing)
    # a torque that varies by less than this part of the rated one does not turn the motor (size)
    least_loaded_share: float = 0.02
    arcs: int = 120  # arcs of a turn over which errors are averaged (computing)
    arc_poses: int = 2  # poses that each must have (statistics)
    # standard deviations of noise beyond which campaigns show an error that they may agree on
    # (statistics)
    sure_std: float = 3.0
    # a torque that varies by less than this part of the largest one is constant (computing)
    varying_share: float = 1e-3


NOISE = Noise()
JUDGING = Judging()
CANDIDATES = Candidates()
EVIDENCE = Evidence()
BLOCKS = Blocks()
MAPS = Maps()
NAMES = Names()
PROBABILITIES = Probabilities()
MOTION = Motion()
CHANGE = Change()
LOOSE = Loose()
SPRINGS = Springs()
TOGETHER = Together()
TORQUES = Torques()
ROWS = Rows()
RIPPLE = Ripple()
LINES = Lines()
WOBBLES = Wobbles()
WARMING = WarmingUp()

#: All of them, by what they decide.
SECTIONS: dict[str, DataclassInstance] = {
    "noise": NOISE,
    "judging": JUDGING,
    "candidates": CANDIDATES,
    "evidence": EVIDENCE,
    "blocks": BLOCKS,
    "maps": MAPS,
    "names": NAMES,
    "probabilities": PROBABILITIES,
    "motion": MOTION,
    "change": CHANGE,
    "loose": LOOSE,
    "springs": SPRINGS,
    "together": TOGETHER,
    "torques": TORQUES,
    "rows": ROWS,
    "lines": LINES,
    "wobbles": WOBBLES,
    "warming": WARMING,
    "ripple": RIPPLE,
    "sessions": SESSIONS,
    "field": FIELD,
    "forms": FORMS,
    "next_poses": NEXT_POSES,
    "places": PLACES,
    "computing": COMPUTING,
}


def decisions() -> dict[str, dict[str, JsonValue]]:
    """Return all but those of computing, as they stand in `verdict.json`."""
    every = {name: asdict(each) for name, each in SECTIONS.items() if each is not COMPUTING}
    plain: dict[str, dict[str, JsonValue]] = to_jsonable_python(every)
    return plain

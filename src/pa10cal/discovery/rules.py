"""Every number that a verdict hangs on, once: what it bounds, its unit and where it is from.

Where it is from, in brackets: `level`, a probability or odds that were chosen; `statistics`, what
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

from pa10cal.discovery.other_numbers import COMPUTING, FIELD, NEXT_POSES, PLACES
from pa10cal.results.record import SURE

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


@dataclass(frozen=True)
class Noise:
    """How noisy readings are: repeats, and where there are few, poses near each other."""

    least_differences: int = 20  # differences below which nothing is said of the noise (statistics)
    # least part of the readings that are repeats, where blocks of poses could be held out instead
    # (trials)
    least_repeated_share: float = 0.25
    # part of the readings that residuals stand for at least, however many parameters (chosen)
    least_left_share: float = 0.5
    # repeats from any side are compared where they are so many times those from one side (trials)
    any_side_ratio: float = 2.0
    same_pose: float = 2e-3  # poses nearer than this in every joint are the same [rad, m] (size)
    # poses up to so far apart make a variogram, whose nugget is the noise [rad, m] (Cressie,
    # Statistics for Spatial Data, 1993)
    near_pose: float = 0.01
    near_steps: int = 5  # steps of distance of that variogram (computing)
    most_neighbours: int = 8  # neighbours that a pose is compared with there (computing)
    # scatter of a torque, in the largest one, that rounding alone makes (size)
    rounded_torque_share: float = 1e-6
    reweighted: int = 2  # times that scatter is found anew about weights fitted with it (computing)
    # torques a column above which their scatter about the weights is their noise (statistics)
    torques_a_weight: int = 2
    # scatter of normal deviates over the median of their sizes (statistics)
    median_to_sigma: float = 1.0 / float(ndtri(0.75))
    huber_tail: float = 1e-3  # share of undisturbed poses that weigh less than fully (level)
    # stated uncertainties are brought down by no more than this factor (size)
    least_shrink: float = 1e-3
    enough_poses: int = 1500  # poses that say enough of how joints scatter (computing)
    variances: tuple[float, float] = (1e-14, 1e-4)  # bounds of these variances [rad², m²] (size)
    first_variance: float = 1e-9  # variance of a joint to begin with [rad²] (computing)


@dataclass(frozen=True)
class Judging:
    """Which campaigns can be judged, and by what."""

    # components of different poses a parameter, where repeats are the judge (trials)
    rows_an_unknown: float = 1.25
    # orientations typically off by so much are none of the arm [rad] (size)
    no_attitude_rad: float = 0.05
    # poses that carry a name alone and are left out, one after the other (trials)
    most_carriers: int = 3
    # one pose carries a name where less than this part of what speaks for it remains without it
    # (trials)
    carried_share: float = 0.5
    # a parameter known no better than this part of what is possible is not identified (trials)
    identified_share: float = 1.0 / 3.0
    gap_level: float = 0.95  # probability of the interval of the gap's reduction (level)
    # root mean square errors over those of noise that are more, where nothing was found (trials)
    more_than_noise: float = 1.15


@dataclass(frozen=True)
class Candidates:
    """Which effects of the vocabulary the poses could show."""

    # least part of an effect that remains beside the model's own parameters (trials)
    least_share: float = 0.02
    # least sum of an effect of its largest plausible size, in standard deviations (statistics)
    least_signal: float = 4.0
    largest_sizes: float = 10.0  # the largest plausible size, in usual ones (size)
    sizes_of_time: float = 3.0  # usual size of effects of time, in plausible ones (trials)
    # waves a turn taken out of a joint's error where poses are read once; of a slow joint (trials)
    waves: tuple[int, int] = (8, 24)
    wave_rad: float = 3e-4  # their expected size [rad] (size)
    named_orders: int = 2  # orders up to here have names of their own (vocabulary)
    near_order: float = 0.5  # orders this near to twice the gear ratio have one, too (vocabulary)
    apparatus_m: float = 5e-6  # how well targets on the apparatus are known, an axis [m] (size)


@dataclass(frozen=True)
class Evidence:
    """Effects where repeats are the judge: evidence, confirmed by sign flips over poses."""

    # readings of a cell at most: a drift shows between the cells of a longer row of repeats
    # (trials)
    readings_a_cell: int = 4
    # standard deviations of an effect that are tried, in its plausible size (size)
    sizes: tuple[float, ...] = (0.1, 1.0, 10.0)
    usual_size: int = 1  # index among these of the one expected first (size)
    # effects whose directions are closer than this cosine look the same (statistics)
    indistinguishable: float = 0.999
    # log evidence that a forward step must gain: it may be a proxy for what comes later [nat]
    # (trials)
    forward_nats: float = 1.0
    most_effects: int = 10  # effects at a time: more are no finding (trials)
    most_rounds: int = 6  # rounds of steps forward and back (computing)
    rounds_of_time: int = 2  # times that motions and effects are sought in turn (computing)
    rounds_of_sizes: int = 4  # times that sizes and operating point are found in turn (computing)
    flips: int = 999  # random sign flips (computing)
    flips_seed: int = 20080427  # their random seed (computing)
    # probability allowed that chance makes as much of the whole family (level)
    false_rate: float = 0.05
    folds: int = 9  # blocks of poses held out in turn beside them (computing)
    # probability allowed that the truth is missing among an effect and its alternatives (level)
    missed_rate: float = 0.03
    # odds of a name from which a map of the joint is no rival of it (level)
    odds_over_map: float = 20.0
    # what linear evidence may be wrong by where rivals are picked to be refitted [nat] (trials)
    refit_margin_nats: float = 4.0
    most_refits: int = 12  # rivals that are refitted (computing)
    # lowest, highest and number of variances tried of the error that a pose shares, in those of a
    # reading; none is tried, too (size)
    pose_variances: tuple[float, float, int] = (1e-2, 1e5, 15)
    # variances looked at between the neighbours of the best one (computing)
    variances_between: int = 129
    form_folds: int = 9  # blocks of poses held out in turn where short forms compete (computing)
    # least standard uncertainty of a reading, in what is stated, where readings are compared (size)
    least_uncertainty_share: float = 0.1


@dataclass(frozen=True)
class Blocks:
    """Effects where poses are read once: blocks of poses held out, each in turn."""

    blocks: int = 10  # blocks of poses (trials)
    least_poses: int = 10  # poses of a block: of fewer their errors say too little (statistics)
    standard_errors: float = 3.0  # standard errors over blocks by which an effect must help (level)
    # part of the remaining error over the noise that an effect must be worth (trials)
    least_share: float = 0.05
    one_sided_deviates: float = 1.645  # standard deviations below which 95 of 100 lie (statistics)
    most_rounds: int = 3  # rounds of the search (computing)
    most_exchanges: int = 5  # names exchanged in a round (computing)
    most_names: int = 4  # names tried at one place (trials)
    # standard errors by which all names of a place may fall behind a map, to be tried (level)
    hopeless_errors: float = 3.0
    # standard errors by which positions or orientations may come out worse for an effect (level)
    worse_errors: float = 2.0
    # part of what positions or orientations gain that the other kind may lose by it (trials)
    most_lost_share: float = 0.1
    # error of held-out blocks over what noise and uncertain parameters give, above which the model
    # lacks something (trials)
    over_expected: float = 1.12
    over_expected_errors: float = 3.0  # standard errors over blocks by which it must be (level)
    # standard error of the median of normal deviates over that of the mean (statistics)
    median_errors: float = 1.2533
    # part of the squared error that parameters may take up by chance (statistics)
    most_by_chance: float = 0.9
    chance_shares: float = 2.0  # times its share of them that a parameter takes up so (chosen)
    lag_rad: float = 1e-4  # what orientations are expected to lag by [rad] (size)
    told_share: float = 0.5  # joints are told that lag by this part of the largest lag (trials)
    # rows are left out where no more than this part of them was seen (computing)
    seen_share: float = 0.75
    # size of weights whose expectation stands among the rows already (computing)
    sizes_not_twice: float = 100.0
    directions: int = 1000  # directions of an effect's parameters that are tried (computing)
    hidden_share: float = 0.05  # part of these that may be hidden behind others (level)
    # cosines along each axis of a drift: one that turns back more often is a wander (trials)
    drift_waves: int = 6
    # part of the variance expected of a target that is left where poses say nothing (statistics)
    open_share: float = 0.25
    # part of the readings that must have a time of their own for it (trials)
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
    weighing_knots: int = 72  # knots of the maps by which poses are weighed (computing)
    # their size and the order at which half as much is expected [rad] (size)
    weighing_prior: tuple[float, float] = (1e-4, 10.0)
    reweighted: int = 2  # times that poses are weighed anew (computing)
    # part of the readings that what is fitted may take up: what is left of more says little of
    # noise (statistics)
    most_taken_share: float = 0.6
    # highest order that decides about a spectrum, in cycles a turn: beyond is the floor (trials)
    highest_band: int = 107
    angle_parts: int = 10  # parts of a joint's visited angles, alike in poses (computing)
    # those of them that are left out: both of few joints, one of many (computing)
    tenths_left_out: tuple[int, ...] = (2, 7)
    few_joints: int = 3  # so many joints are few (computing)
    # weights of orientations that are tried, in their scatter (trials)
    attitude_weights: tuple[float, ...] = (1.0, 0.5, 0.25)
    # how far the logarithms of a band's numbers may be off usual ones, a standard deviation (size)
    band_std: tuple[float, ...] = (1.0, 1.0, 1.0, 0.5, 0.5, 0.5, 1.0)
    # how far those of a joint may be off the arm's (size)
    band_std_of_joint: tuple[float, ...] = (0.5, 0.4, 0.3, 0.2, 0.15, 0.2, 0.6)
    angles_a_turn: int = 360  # angles at which errors of two campaigns are compared (computing)
    compared_poses: int = 10  # poses near an angle by which a campaign visited it (trials)
    compared_within_deg: float = 1.5  # so near [deg] (trials)
    # arc left out at a time for the interval of their agreement [deg] (trials)
    compared_arc_deg: float = 7.5
    compared_arcs: int = 3  # arcs without which there is no interval (statistics)


@dataclass(frozen=True)
class Names:
    """When what was found has a name that is told."""

    # parameters of a named effect are within so many plausible sizes (size)
    most_sizes: float = 10.0
    # probability of the region of an effect's parameters that must not hold zero (level)
    confidence: float = 0.95
    most_alternatives: int = 6  # with more alternatives a name says nothing (trials)
    # error left, held-out error, repeatability and stated uncertainty agree within this factor
    # (trials)
    agree_ratio: float = 3.0
    # lack of fit F of the torques that is none: 0.8 to 1.1 without a fault, 1.6 where one of three
    # loads is stated 40 N for 44 (trials)
    most_torque_ratio: float = 1.3
    torque_p_value: float = 1e-6  # p value from which on it is one (level)
    # part of the error that weights other than described may leave, to be told (trials)
    most_left_share: float = 0.9
    # held-out errors larger by this factor are worse, whatever chance may do (trials)
    worse_ratio: float = 1.02
    # times as likely as a name something else must be, to be told in its place (level)
    likelier: float = 2.0
    much_worse_ratio: float = 1.05  # by this factor they speak against a name (trials)
    # held-out errors larger by less are the same, however sure it is (trials)
    trifling_ratio: float = 1.005
    # held-out errors over what noise and the model's uncertainty explain by which a name is
    # contradicted (trials)
    contradicted_ratio: float = 1.5


@dataclass(frozen=True)
class Probabilities:
    """How probable a name is, among all that was tried in its place."""

    # what scores by blocks of poses are divided by, as poses err alike (trials)
    blocks: float = 3.0
    draws: int = 1000  # draws of the weights of blocks (computing)
    # weight beside a name of what can do all that it does and more, maps and smooth functions, by
    # blocks of poses (level)
    flexible: float = 1.0 / Evidence.odds_over_map
    pull: float = 0.3  # weight of a pull at a joint beside its gear ratio (trials)
    unknown: float = 0.01  # probability that nothing that was tried is there (trials)
    # the same where repeats judge and more than noise is left without a name (trials)
    unknown_beside: float = 0.17
    # by blocks: odds of an effect that takes away as much of the squared error as is left, by which
    # power of that ratio they grow, and of what is left over noise they fall (trials)
    known_effect: tuple[float, float, float] = (7.0, 0.2, 0.5)
    known_sag: tuple[float, float] = (1.3, 1.0)  # the same of a joint that gives way (trials)
    left_of_noise: float = 0.01  # part of that of noise that is left at least (computing)
    most_left_of_noise: float = 3.0  # up to which odds fall (trials)
    # probability of none of these from which an effect has no name (level)
    nameless: float = 0.5
    surely: float = SURE  # probability of the set that holds what is there (level)
    least: float = 0.01  # probability from which an alternative is listed (level)


@dataclass(frozen=True)
class Motion:
    """Base and instrument that moved: walks, jumps, drifts."""

    # lowest, highest and number of root mean squares of a walk tried [m] (size)
    walks_m: tuple[float, float, int] = (3e-6, 3e-3, 9)
    # standard deviations of a jump tried [m] (size)
    jumps_m: tuple[float, ...] = (3e-5, 3e-4, 3e-3)
    # turns expected with a shift, or none [rad/m] (size)
    turns_rad_per_m: tuple[float, ...] = (0.0, 1.0)
    # sizes of effects tried beside, in their plausible size (size)
    effect_sizes: tuple[float, ...] = (0.1, 1.0, 3.0)
    # lowest, highest and number of variances tried of the error that a pose shares, in those of a
    # reading; none is tried, too (size)
    pose_variances: tuple[float, float, int] = (0.1, 1e4, 7)
    false_rate: float = 1e-3  # probability allowed of seeing a motion where there is none (level)
    most_jumps: int = 4  # jumps that may be found (trials)
    least_side: int = 4  # readings on either side of a jump (statistics)
    coarse_times: int = 40  # times of a jump first scanned (computing)
    # a motion counts from this part of the noise of one reading on, root mean squares (trials)
    least_noise_ratio: float = 0.5
    # noise is no less than this part of that by which rows are whitened: more columns than rows
    # could else explain it all (trials)
    least_noise_share: float = 0.3
    # log evidence by which another time of a jump may be worse [nat] (level)
    as_good_nats: float = 3.0
    # a pause is so many times as long as readings are usually apart (trials)
    pause_ratio: float = 30.0
    pause_s: float = 600.0  # and no less than this [s] (size)
    # log evidence from which a drift shows between the readings of a pose [nat] (level)
    drift_nats: float = 5.0
    by_load_m: float = 1e-3  # motion of the base expected from load to load [m, rad] (size)
    targets_m: float = 3e-2  # how far targets may be off where they were fitted [m] (size)
    most_readings: int = 1200  # readings, spread evenly over time, that stand for more (computing)
    # waves of a walk over the campaign: beyond them 4 % of its variance is left (computing)
    walk_waves: int = 16
    # waves of the base over the positions of a joint that goes with the order of rows (trials)
    rival_waves: int = 8
    rival_m: float = 1e-3  # their size [m] (size)
    # times that what is found of time is held against errors that go with more joints (computing)
    most_rivals: int = 4


@dataclass(frozen=True)
class Change:
    """What changed at a row: a target that slipped, another reflector, another model in the log."""

    size: float = 1e-3  # size expected of a length or turn that changed [m, rad] (size)
    scales: tuple[float, ...] = (0.1, 0.3, 1.0, 3.0, 10.0)  # times that size that are tried (size)
    static_sizes: float = 10.0  # usual sizes that a model fitted to a mixture may be off (size)
    # how far base and targets of another model are expected to be off [m, rad] (size)
    frames: float = 3e-3
    # squares below this part of those without a change are not told apart: rows are linear no
    # better (computing)
    same_squares: float = 1e-3
    least_side: int = 10  # readings on either side (statistics)
    false_rate: float = 1e-3  # probability allowed of seeing a change where there is none (level)
    # log evidence by which it must be better than a step of the base [nat] (trials)
    better_nats: float = 9.0
    # log evidence up to which another kind of change is as good [nat] (level)
    as_good_nats: float = 3.0
    # part of the squared error that it may leave: what goes with the pose goes with many a row a
    # little (trials)
    most_left_share: float = 0.5
    # it counts from this part of the stated noise of a reading on (trials)
    least_noise_ratio: float = 0.5
    courses: int = 3  # powers of time that it is held against: what grows comes on slowly (trials)
    row_nats: float = 3.0  # log evidence by which another row of it may be worse [nat] (level)


@dataclass(frozen=True)
class Springs:
    """Joints that give way."""

    # no joint is named that gives way by less at its largest torque [rad] (size)
    least_rad: float = 1e-6
    stretches: int = 40  # stretches of time whose poses may err alike (trials)
    stretch_poses: int = 4  # least poses in each (statistics)


@dataclass(frozen=True)
class Together:
    """Sets of effects that may be there, under weights that nobody stated."""

    # what gives way may do so by so many times what is plausible under weights as assumed, which
    # are uncertain by as much as they are (trials)
    sizes: float = 3.0
    # an amount that is physically none below zero may be found so many standard uncertainties below
    # (level)
    below_zero: float = 2.0
    most_poses: int = 2000  # poses by which sets are compared (computing)
    steps: int = 10  # steps to the amounts and weights of a set (computing)
    steps_beside: int = 2  # the same from a set that differs by one step (computing)
    # change of an amount, in its size, or of nats, at the last one (computing)
    settled: float = 1e-3
    looked_at: int = 5  # sets ahead that are looked at as they are (computing)
    # log evidence by which a rival may be worse that is looked at as it is [nat] (computing)
    near_nats: float = 5.0
    # members that alone make rows likeliest, from each of which a search begins (computing)
    begun_with: int = 5
    # squares of the noise that a combination of weights must be able to move (computing)
    least_squares: float = 0.01
    rounding: float = 1e-12  # part of the largest products that rounding leaves (computing)


@dataclass(frozen=True)
class Torques:
    """Faults of logged torques."""

    fault_nats: float = 6.9  # gain in evidence that a fault needs: odds of 1000 to 1 [nat] (level)
    # squares, in those of the noise, that it must take away of either half alone (level)
    half_squares: float = 4.0
    least_sizes: float = 0.3  # part of its plausible size that it must have (trials)
    reweighted: int = 5  # times that scatter is found anew about what is fitted (computing)
    least_noise_Nm: float = 1e-9  # least noise of a torque [N m] (computing)


@dataclass(frozen=True)
class Rows:
    """Faults of single rows: gross errors, exchanged labels, slips of a load."""

    # labels are exchanged where another order leaves so little of what is left (trials)
    exchanged_left_share: float = 0.25
    most_targets: int = 5  # targets whose orders are all tried (computing)
    # probability that any reading is excluded where none is wrong and errors are normal (level)
    excluded_rate: float = 0.1
    # readings before and after: where most of them are off as well, something happened in time
    # (trials)
    neighbours: int = 5
    # relative error of a scatter found from one deviate by its median, twice (statistics)
    scale_error: float = 2.3
    # probability allowed of accusing a mean of a pose: their tails are lighter than those of
    # readings (level)
    of_poses_rate: float = 1e-3
    # standard errors by which their tails may be heavier than found (level)
    of_poses_errors: float = 1.6
    most_beyond_share: float = 0.1  # more readings than this part are no gross errors (trials)
    least_of_a_joint: int = 5  # readings that one joint alone put off are no gross errors (trials)
    of_a_joint_share: float = 0.95  # it makes this part of their squares (trials)
    of_a_joint_times: float = 3.0  # and none is so many times the usual size (trials)
    least_noise_share: float = 0.1  # scatter is no less than this part of the noise found (size)
    median_readings: int = 11  # readings over which a median runs (computing)
    # a reading's load is within this part of the difference from the other load (trials)
    near_load_share: float = 0.25
    load_known_times: float = 3.0  # and known so many times better than that difference (level)
    load_errors: float = 8.0  # it is so many times its uncertainty from the load stated (level)
    # and the other load leaves no more than this part of the squared error (trials)
    load_left_share: float = 0.25
    # more than this part of the readings are no slip: a load is misstated, or a torque wrong
    # (trials)
    most_slips_share: float = 0.1


@dataclass(frozen=True)
class Lines:
    """Lines of gears whose ratio nobody stated."""

    # lowest and highest cycles a turn: below are errors by the joint's angle, that maps follow;
    # above is twice the ratio of any gear but a few (size)
    orders: tuple[float, float] = (13.0, 360.0)
    size_rad: float = 1e-4  # size of a line by which it is sought [rad] (size)
    # widths within which numbers of cycles are one line (statistics)
    widths_apart: float = 2.0
    # nats by which the best number must stand out of all others, further away (level)
    better_nats: float = 4.6
    angle_decimals: int = 4  # of angles [rad] that are different (size)
    step_widths: float = 0.5  # steps by which lines are sought, in widths (computing)
    order_decimals: int = 3  # of cycles a turn, as a line is known by (told)
    least_angles: int = 50  # different angles of a joint below which no line is sought (statistics)
    most_poses: int = 2000  # poses that say enough of where lines are (computing)
    at_once: int = 100  # numbers of cycles that are computed together (computing)
    most_rounds: int = 3  # times that lines are sought anew, beside those found (computing)


@dataclass(frozen=True)
class Wobbles:
    """Axes that wobble, which have to stand out of all that may give way under the weights."""

    # plausible sizes by which bearings, links and base may give way, about any axes (trials)
    sizes: float = 10.0
    # nats by which the wobble of one joint must stand out of that of any other (level)
    better_nats: float = 4.6


@dataclass(frozen=True)
class Ripple:
    """The motor's ripple in residuals of joints, which tells sensors from gears."""

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
    # a torque that varies by less than this part of the largest one is constant (computing)
    varying_share: float = 1e-3


@dataclass(frozen=True)
class Forms:
    """Short formulas for what has no name."""

    standard_errors: float = 3.0  # standard errors over blocks by which a form must help (level)
    # part of what is over the noise that it must take away (trials)
    least_explained_share: float = 0.8
    # standard errors within which forms do equally well: the best of many is so by chance, too
    # (level)
    tie_errors: float = 2.0
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
SPRINGS = Springs()
TOGETHER = Together()
TORQUES = Torques()
ROWS = Rows()
RIPPLE = Ripple()
LINES = Lines()
WOBBLES = Wobbles()
FORMS = Forms()

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
    "springs": SPRINGS,
    "together": TOGETHER,
    "torques": TORQUES,
    "rows": ROWS,
    "lines": LINES,
    "wobbles": WOBBLES,
    "ripple": RIPPLE,
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

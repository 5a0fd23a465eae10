"""`discovery/verdict.json` and `extended.json`: what is missing, and the model with it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field, JsonValue

from pa10cal.results import arrays, record
from pa10cal.results.calibration import EffectByCampaign
from pa10cal.results.evaluation import Accuracy, BeforeAfter, EffectParameter, Parameter
from pa10cal.results.maps import AnglesSeen, Bands, FallsBack, JointWitness, MapForm, PoseScatter

#: Start of the names of a map's parameters; its number follows.
KNOT = "knot_"


def _number_of(knot: str) -> int:
    return int(knot.removeprefix(KNOT))


Verdict = Literal["none", "named", "ambiguous", "unexplained", "check_the_log", "not_sought"]


class CrossValidation(record.Part):
    """What an effect explains of the error of poses that its fit did not see."""

    explained: float  # part of the squared error that the effect explains
    z: float  # mean gain over poses, in standard errors


class EvidenceByRepeats(record.Part):
    """Statistics that decided about an effect, against the scatter of repeats."""

    lost_without_it_nats: float  # log evidence lost without the effect
    needed_nats: float  # log evidence needed
    p_sign_flips_max_t: float  # p value of the sign-flip test
    p_needed: float  # p value needed
    cross_validation_over_poses: CrossValidation  # cross-validation over poses
    # cross-validation over loads; null where there is one load only
    cross_validation_over_loads: CrossValidation | None


class BlockedCrossValidation(record.Part):
    """How well blocks of poses that the fit did not see are predicted."""

    rms_without_mm: float  # root mean square error without the effect [mm]
    rms_with_mm: float  # root mean square error with it [mm]
    blocks: int  # blocks of poses
    improved: int  # blocks that the effect predicts better
    gain: float  # part of the weighted squared error that it explains
    gain_std: float  # standard error of the gain
    z: float  # gain in standard errors


class EvidenceByBlocks(record.Part):
    """Statistics that decided about an effect, by blocks of poses."""

    cross_validation_over_blocks: BlockedCrossValidation  # cross-validation over blocks of poses


class EvidenceOfSag(record.Part):
    """Statistics that decided about a joint that gives way under weights that nobody stated."""

    lost_without_it_nats: float  # log evidence lost with the joint rigid
    needed_nats: float  # log evidence needed
    sag_mrad: float  # largest deflection over the poses fitted [mrad]
    sag_u_mrad: float  # its standard uncertainty [mrad]
    rigid_mm: float  # root mean square position error of the poses fitted, the joint rigid [mm]
    gives_way_mm: float  # the same as the joint is [mm]
    held_out_rigid_mm: float | None  # of held-out poses, the joint rigid [mm]; null without any
    held_out_gives_way_mm: float | None  # the same as the joint is [mm]
    # of held-out poses, or else of those fitted, with all joints rigid that give way [mm]
    all_rigid_mm: float


class EvidenceByTorques(record.Part):
    """Statistics that decided about errors that logged torques show by themselves."""

    standard_uncertainties: float  # its size in standard uncertainties
    of_rated: float  # its size at rated torque, over that torque


#: Statistics that decided about an effect, by who judged.
Evidence = EvidenceByRepeats | EvidenceByBlocks | EvidenceOfSag | EvidenceByTorques


class Alternative(record.EffectName):
    """An effect that may be there in the place of one that was named."""

    probability: float  # that it is


class NamedEffect(record.EffectName):
    """An effect that was named."""

    parameters: Mapping[record.ParameterKey, EffectParameter]  # its parameters
    probability: float  # that it is there, among all that was tried in its place
    # effects that may be there in its place, the likeliest first, down to a probability of 0.01
    alternatives: tuple[Alternative, ...]
    # smallest set of effects that holds what is there with a probability of 0.95, beside none of
    # these
    set95: tuple[record.EffectName, ...]

    @property
    def knots(self) -> tuple[EffectParameter, ...]:
        """Return the errors at the even knots of a turn of a map; none of any other effect."""
        names = (name for name in self.parameters if name.startswith(KNOT))
        return tuple(self.parameters[name] for name in sorted(names, key=_number_of))

    @property
    def all_names(self) -> tuple[record.Name, ...]:
        """Return the name and those of what else is likely."""
        return (self.name, *(each.name for each in self.likely))

    @property
    def likely(self) -> tuple[Alternative, ...]:
        """Return the alternatives that may well be there, by the smallest set."""
        members = {each.name for each in self.set95}
        return tuple(each for each in self.alternatives if each.name in members)

    @property
    def either(self) -> str:
        """Return the name and what else is likely in words: `backlash of joint 2 or ...`."""
        return " or ".join((f"{self.id} of {self.of}", *self.rivals))

    @property
    def rivals(self) -> list[str]:
        """Return what else is likely, in words."""
        return [f"{rival.id} of {rival.of}" for rival in self.likely]


class FoundEffect(NamedEffect):
    """An effect that was named, with what decided."""

    others: float  # probability of all that is not listed among the alternatives
    none_of_these: float  # probability that none is there that has a name
    form: MapForm | None  # form of a map that has its own; null for every other effect
    evidence: Evidence  # the statistics that decided
    # the effect that was found with this evidence, where a likelier one has taken its place and was
    # fitted instead
    evidence_of: record.EffectName | None = record.optional()
    # whether the joint's sensor or its gear errs; of errors by its angle, where anything is known
    # of it
    witness: JointWitness | None = record.optional()
    # where the weights come from under which a joint gives way, where the arm's description states
    # none: its stiffness is known relative to assumed ones
    weights: Literal["assumed", "total", "logged"] | None = record.optional()
    # joint, from 1, whose turn moves that of a coupling along, where it is one
    by: int | None = record.optional()


class Unexplained(record.Part):
    """Something without a name."""

    of: str | None  # where it sits; null where the data do not say
    form: str | None  # the smooth function that predicts it; null if none does
    # its position error [mm]; null where it has been modelled by a map
    shared_error_mm: float | None
    why: str  # why it has no name
    # true where what fits best would have an amount surely below zero, as no such effect has
    below_zero: bool = Field(default=False, exclude_if=lambda value: not value)


#: What is wrong in a log; `docs/results.md` lists the word, `docs/how-to/faults.md` what it means.
FaultKind = Literal[
    "label",
    "load",
    "direction",
    "joint_zero",
    "joint_sign",
    "payload",
    "gravity",
    "step_in_time",
    "outlier",
]


class Fault(record.Part):
    """Something in the log that is wrong."""

    kind: FaultKind  # which fault
    where: str  # column, joint, load, pose, row or time
    what: str  # what is wrong and by how much
    remedy: str  # what to do about it
    # part of the weighted squared error that putting it right takes away, of exchanged loads that
    # of the torques where these were logged; null where that was not tried
    gain: float | None


class SuspectedReading(record.Part):
    """A reading that is left out of the search."""

    where: str  # pose, load and repeat
    what: str  # how far it is off the others of its pose, or off the model where there are none


class AllUnexplained(Unexplained):
    """Everything without a name; the keys beside `all` are those of the largest."""

    all: tuple[Unexplained, ...]  # every place, the largest first


class NotTestable(record.EffectName):
    """An effect that the data cannot show."""

    why: str  # why not


class Reduction(record.Part):
    """Mean reduction of the position error, poses being the unit."""

    mean_mm: float  # mean reduction [mm]
    interval95_mm: tuple[float, float]  # its 95 % interval [mm]
    poses: int  # number of poses


class LoadGap(BeforeAfter):
    """The gap at one load."""

    reduction: Reduction  # mean reduction of the error


class SetGap(LoadGap):
    """The gap over some configurations."""

    noise_floor_mm: float  # mean position error that repeatability alone leaves [mm]
    per_load: Mapping[record.LoadKey, LoadGap]  # the gap at each load
    # of a group, the gap in each campaign; not given of a single one
    per_campaign: Mapping[record.CampaignKey, LoadGap] | None = record.optional()
    # inside the joint angles that maps have learnt from; null where effects were judged by repeats,
    # no map was found, or no configuration is
    inside: BeforeAfter | None
    outside: BeforeAfter | None  # outside them; null likewise
    # without configurations that have a suspected reading (`faults`); not given where none has
    trusted: BeforeAfter | None = record.optional()
    # the same with the motion of base or instrument that was found taken out of the readings: no
    # model holds it, and no other number here is without it; not given where none was found
    without_motion: BeforeAfter | None = record.optional()
    # errors of a model that is not written: with the smooth unknown functions, too, that the search
    # held and that are no names; not given where it held none
    with_rivals: Accuracy | None = record.optional()


class Gap(record.Part):
    """The error before (calibrated model) and after (with the named effects).

    Both models are those that are written: the calibration's and `extended.json`'s. Where effects
    were not sought, both are those of the calibrated model.
    """

    # mean position error of averaged poses that noise alone leaves [mm]: what successive readings
    # of a pose, load and direction of arrival scatter by (unidirectional repeatability), or as
    # `noise_floor_from` says
    noise_floor_mm: float
    # what the noise floor was found from, where not from repeats
    noise_floor_from: str | None = record.optional()
    # that readings of single targets wander in time, each by itself, and for how long; only where
    # they do as much as all targets together
    readings_wander: str | None = record.optional()
    train: SetGap  # over the poses fitted
    # over held-out poses, which are never used to choose or fit; null without any
    holdout: SetGap | None


class Tried(record.EffectName):
    """An effect tried on the remaining error."""

    gain: float  # part of the remaining squared error that it explains
    gain_std: float  # standard error of the gain
    helps: bool  # whether the gain is significant
    # whether both gain by it; null where that was not looked at
    positions_and_attitudes_agree: bool | None
    # whether its parameters are such as it can have; null where that was not looked at
    physical: bool | None = None


class Remaining(record.Part):
    """The error that remains of blocks held out of the fit, against the noise."""

    mean_mm: float  # mean position error [mm]
    std_mm: float  # standard error of the mean over blocks [mm]
    rms_mm: float  # root mean square position error [mm]
    floor_mm: float  # mean position error that noise leaves [mm]
    # mean position error that noise and uncertain parameters leave [mm]; not in earlier files
    expected_mm: float | None = None
    over_floor: bool  # whether it is significantly above that
    tried: tuple[Tried, ...]  # what else was tried, the best first


class SharedError(record.Part):
    """Position error that all readings of a pose share."""

    before: float  # of the calibrated model [mm]
    after: float  # with the effects [mm]


class SearchKeys(record.Part):
    """How effects were searched for."""

    candidates: int  # effects tried
    error_rate: float  # rate of false names allowed

    @property
    def excluded(self) -> int:
        """Return how many readings were excluded as gross errors."""
        return 0


class SearchByRepeats(SearchKeys):
    """How effects were searched for, against the scatter of repeats."""

    needed_nats: float  # log evidence needed of an effect
    shared_error_mm: SharedError  # position error shared by readings of a pose
    readings_excluded: int  # readings suspected of a gross error

    @property
    def excluded(self) -> int:
        """Return how many readings were excluded as gross errors."""
        return self.readings_excluded


class Needed(record.Part):
    """What an effect must bring."""

    standard_errors: float  # gain in its standard errors, at least
    sum_of_squares: float  # gain in the weighted sum of squares, at least
    # gain as part of the remaining error above noise, at least
    part_of_remaining_error_over_noise: float


class SearchByBlocks(SearchKeys):
    """How effects were searched for, by blocks of poses."""

    blocks: int  # blocks of poses
    needed: Needed  # what an effect must bring
    poses_down_weighted: int  # poses with a robust weight below 1
    refit_converged: bool  # whether the last refit converged


class SuggestedPose(record.Part):
    """A configuration to measure next."""

    q_deg: arrays.Numbers  # joint positions [deg; mm of a sliding joint]
    q_rad: arrays.Numbers  # joint positions [rad; m of a sliding joint]
    load_N: float  # load [N]
    # side from which each joint arrives: -1 from smaller angles, +1 from larger ones
    arrive_from: arrays.Numbers | None = record.optional()
    # expected log evidence between the alternatives, with all configurations up to this one
    separation_nats: float | None = record.optional()
    for_: tuple[str, ...] = Field(alias="for")  # what it serves


class Separation(record.Part):
    """How far apart two explanations are expected to come."""

    pair: str  # the explanations
    before_nats: float  # log evidence between them now
    after_nats: float  # expected with the suggested poses
    possible_nats: float  # expected with all poses considered
    can_be_split: bool  # whether poses can separate them at all
    # probability of the effect found, between the two
    probability: float | None = record.optional()
    # that of whichever is the likelier then, as it is expected after the suggested poses
    expected_probability: float | None = record.optional()


class ProposedEvidence(record.Part):
    """How blocks of poses that were left out of the fit are predicted.

    Squared errors are weighted: where repeats are the judge, a row of noise alone leaves 1.
    """

    blocks: int  # blocks of poses, each left out in turn
    rows: int  # weighted components of all of them
    squared_error_without: float  # their squared error with nothing instead
    squared_error_with: float  # their squared error with the formula
    # their squared error with what it does as well as; null where that is noise
    squared_error_held: float | None
    gain_std: float  # standard error of `gain`


class ProposedFormula(record.Part):
    """A short formula that does as well as something without a name; no effect is named by it."""

    formula: str  # the form, in words a reader can type
    of: str  # where it sits
    form: str  # which of the forms tried, as `harmonic` or `torque_cubed`
    # what fixes the form besides its parameters: orders, thresholds, axes from 0
    numbers: tuple[float, ...]
    # lowest and highest order, in cycles a turn, that does as well
    orders: tuple[int, int] | None = record.optional()
    parameters: Mapping[record.ParameterKey, EffectParameter]  # its parameters
    gain: float  # part of the squared error of blocks of poses left out that it takes away
    # maps and smooth unknown functions in whose place it was tried; none where it leaves no more
    # than noise
    does_as_well_as: tuple[record.EffectName, ...]
    others: tuple[str, ...]  # other formulas, none of them shorter, that do as well
    evidence: ProposedEvidence  # what decided


class ExplainedEffect(record.Part):
    """What one effect takes away of the error."""

    ids: tuple[str, ...]  # id of the effect, then of its alternatives at the same place
    of: str  # where it sits: `joint 2`, `forearm`, `base`, ...
    # alternatives at other places; not given where there is none
    elsewhere: tuple[record.EffectName, ...] = Field(default=(), exclude_if=lambda value: not value)
    # `assumed` where its size is known relative to weights that nobody stated
    weights: Literal["assumed"] | None = record.optional()
    # of what is predicted without a name: part of its variance that goes with each joint, by number
    joints: Mapping[Annotated[str, record.Key("joint")], float] | None = record.optional()
    # that it is there, among all that was tried in its place; not given of what has no name
    probability: float | None = record.optional()
    # of its alternatives: the other `ids`, then those elsewhere
    others_probability: tuple[float, ...] = Field(default=(), exclude_if=lambda value: not value)
    share: float  # part of the variance of the error beyond noise that it takes away, 0 to 1
    before_mm: float  # root mean square error without it alone, all else fitted again [mm]
    after_mm: float  # root mean square error with all effects [mm]

    @property
    def name(self) -> record.Name:
        """Return the name of the effect, without its alternatives."""
        return record.Name(self.ids[0], self.of)

    @property
    def has_no_name(self) -> bool:
        """Return whether it is predicted without a name: by a smooth function of all joints."""
        return self.joints is not None


class Explained(record.Part):
    """How much of the error beyond noise is explained, and by what."""

    # part of the variance of the position error beyond noise that the model loses by the effects, 0
    # to 1
    share: float
    # its 95 % interval over poses like these; not given where nothing is explained
    interval95: tuple[float, float] | None = record.optional()
    # what each effect takes away, the largest share first; shares sum to `share`
    of: tuple[ExplainedEffect, ...]
    without_a_name: float  # part that remains, 1 less `share`
    # poses that it is counted over: held out, where any were
    over: Literal["held-out poses", "fitted poses"]
    before_mm: float  # root mean square error of the model without them [mm]
    after_mm: float  # root mean square error of the model with all of them [mm]
    noise_mm: float  # root mean square error that noise alone would leave [mm]


class VerdictKeys(record.Part):
    """The verdict on a campaign."""

    # `named` when every effect found has a probability of 0.95; `ambiguous` when one has less;
    # `unexplained` when a significant gap remains that no effect closes; `none` when model and data
    # agree within the repeatability; `check_the_log` when what fits best is a fault of the data;
    # `not_sought` when the campaign has too few poses or repeats for a search
    verdict: Verdict
    why: str | None = record.optional()  # why effects cannot be sought, where `not_sought`
    remedy: str | None = record.optional()  # what would do, where `not_sought`
    # true where the extended model has the weights that the poses show beside those stated, or a
    # load or tool other than stated: it is exported even where no effect is named. Not given where
    # torques were logged, no spring is loaded, or other faults may stand for weights
    fits_weights: bool | None = record.optional()
    # how effects were judged; null where they were not sought
    method: Literal["evidence of repeats", "cross-validation over blocks"] | None
    # how much of the position error beyond noise the effects found take away, and each of them; not
    # given where the calibrated model errs by no more than noise, the verdict is `none`, or effects
    # were not sought
    explained: Explained | None = record.optional()
    effects: tuple[FoundEffect, ...]  # effects named, in the order found
    # faults of the log; `effects` then holds those that stand whatever becomes of them, and single
    # readings with a gross error alone leave the verdict as it is where effects stand
    faults: tuple[Fault, ...]
    # readings left out of the search that may have a gross error; `faults` lists those that surely
    # have one
    suspected_readings: tuple[SuspectedReading, ...] | None = record.optional()
    unexplained: AllUnexplained | None  # what has no name; null if nothing remains
    # short formulas that do as well as a map or as what has no name; they name nothing, and are not
    # in the extended model
    proposed: tuple[ProposedFormula, ...] | None = record.optional()
    # effects that these data cannot show, found before residuals are looked at
    not_testable: tuple[NotTestable, ...]
    # effects that are sought, but would be missed in more than 5 of 100 such campaigns at their
    # plausible size; found likewise
    below_detection_limit: tuple[NotTestable, ...] | None = record.optional()
    # effects that these poses cannot separate, found likewise
    indistinguishable: tuple[tuple[record.EffectName, ...], ...]
    gap: Gap  # the error before and after
    remaining: Remaining | None = record.optional()  # remaining error of blocks held out of the fit
    # how effects were searched for; null where they were not
    search: SearchByRepeats | SearchByBlocks | None
    # bands of maps, found from the data, where they have some
    bands: Bands | None = record.optional()
    # what single poses scatter by about the extended model, where maps have a band
    scatter: PoseScatter | None = record.optional()
    # values of each joint seen by the fit, where effects were judged by blocks and a map was found:
    # it holds there
    angles_seen: tuple[AnglesSeen, ...] | None = record.optional()
    # where the extended model leaves the effects out, because held-out poses are predicted worse
    # with them than before
    falls_back: FallsBack | None = record.optional()
    # configurations to measure next, the most useful first
    suggested_poses: tuple[SuggestedPose, ...]
    # how far apart the suggested poses are expected to bring each pair
    separations: tuple[Separation, ...] | None = record.optional()
    # why no poses that would separate effects are suggested, and what to do
    no_separating_poses: str | None = record.optional()

    @property
    def adds_to_calibrated(self) -> bool:
        """Return whether the extended model predicts more than the calibrated one."""
        return bool(self.effects or self.fits_weights) or self.predicts_nameless

    @property
    def predicts_nameless(self) -> bool:
        """Return whether the extended model predicts what has no name."""
        return self.explained is not None and any(part.has_no_name for part in self.explained.of)

    @property
    def effects_by_share(self) -> tuple[FoundEffect, ...]:
        """Return the effects in the order of what they take away, where that is known."""
        if self.explained is None:
            return self.effects
        known = {each.name: k for k, each in enumerate(self.explained.of)}
        return tuple(sorted(self.effects, key=lambda each: known.get(each.name, len(known))))


#: Numbers that a verdict hangs on, by the part of discovery that they belong to.
Rules = Mapping[
    Annotated[str, record.Key("part")], Mapping[Annotated[str, record.Key("number")], JsonValue]
]


@record.filed("pa10cal-verdict/1", "discovery/verdict.json", by="discover")
class VerdictRecord(VerdictKeys, record.MeasuredRecord):
    """`discovery/verdict.json`."""

    arrival_from_order: bool  # whether directions of arrival come from the order of the poses
    # null: the time taken stands in the log, so that equal runs have equal results
    seconds: float | None
    # of a group, every effect found as each campaign alone has it
    by_campaign: tuple[EffectByCampaign, ...] | None = record.optional()
    # every number that the verdict hangs on, as in docs/discovery.md
    rules: Rules | None = record.optional()


class MovedZero(record.Part):
    """A step in the zero of a joint."""

    joint: int  # from 1
    at_s: float  # most likely time of the step [s]
    before_s: float  # time of the last reading that is surely before it [s]
    after_s: float  # time of the first reading that is surely after it [s]
    moved: float  # by how much the zero moved [rad, m]


@record.filed("pa10cal-extended/1", "discovery/extended.json", by="discover")
class ExtendedRecord(record.MeasuredRecord):
    """`discovery/extended.json`."""

    # every parameter of the calibrated model and the base frame, with the effects
    parameters: Mapping[record.ParameterKey, Parameter]
    T_instr_base: arrays.PoseMatrix  # base frame in the instrument's frame [m]
    # the fitted model as `model.yaml` holds it (schema pa10cal-model/2); its covariance is in
    # `extended.covariance.npz`
    fitted_model: Mapping[Annotated[str, record.Key("key")], JsonValue]
    # values of each joint seen by the fit, where effects were judged by blocks and a map was found:
    # it holds there
    angles_seen: tuple[AnglesSeen, ...] | None = record.optional()
    robot: str  # name of the arm
    calibration: str  # load case of the calibration it began with
    verdict: Verdict  # the verdict
    arrival_from_order: bool  # whether directions of arrival come from the order of the poses
    # times at which instrument or base moved suddenly, the most certain first [s]; not given where
    # they did not
    steps_s: tuple[float, ...] | None = record.optional()
    # steps in the zeros of joints: the model is of the arm since the last of them, and readings
    # before are corrected; not given without any
    moved_zeros: tuple[MovedZero, ...] | None = record.optional()
    named: tuple[NamedEffect, ...]  # effects named, with uncertainties
    # true where it has weights as the poses show them, see the verdict
    fits_weights: bool | None = record.optional()
    warnings: tuple[str, ...]  # what to know before the model is trusted

    @property
    def adds_parameters(self) -> bool:
        """Return whether its parameters are those of the exported model, not the calibrated one."""
        return bool(self.named or self.fits_weights or self.moved_zeros)

    @property
    def grade(self) -> str:
        """Return the grade of the calibration it began with, as the effects leave it."""
        return str(self.fitted_model.get("grade"))

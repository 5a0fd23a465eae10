"""Which geometric parameters arm and instrument can identify: complete and minimal.

Complete: every parameter with an effect is there, or replaced by others. Minimal: none of them is
redundant. Candidates are taken one after the other: the base, other frames, targets, then the links
from the base outward; one whose column of the Jacobian is a combination of those before it is
omitted. A column that others represent only by large coefficients replaces the last of these: along
nearly parallel axes, links represent the height of tool or target only by a shift of metres.

This depends on arm and instrument alone, so it is decided at random joint positions within the
limits, before any reading. What the measured poses then identify is a separate question, which the
rank answers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index
from pa10cal.calibration.rules import UNKNOWNS
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.quantities import Start
from pa10cal.options import Tolerances
from pa10cal.results.calibration import Redundant
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import Offsets, base_frame, link_departures, tool_frame
from pa10cal.terms.term import TermParameter
from pa10cal.terms.wrapped import OfCampaign, OfPart


@dataclass(frozen=True)
class ChosenUnknowns:
    """The geometric parameters of a complete and minimal model."""

    links: Offsets  # departures kept
    # motions kept of the tool, none where the instrument has targets of its own; of a group, of
    # every campaign's tool and of the bases of all campaigns but the first
    frames: tuple[Offsets | OfCampaign | OfPart, ...]
    base: Offsets  # motions of the base kept
    targets_kept: Index  # coordinates of targets kept, as indices into `target_parameters`
    redundant: tuple[Redundant, ...]  # parameters omitted, with those that replace them


def choose_unknowns(
    arm: Arm, tolerances: Tolerances, measured: Instrument, start: Start
) -> ChosenUnknowns:
    """Choose the parameters that arm and instrument can identify.

    Args:
        measured: the instrument; its readings play no part.
        start: approximate frames and targets.
    """
    links, base, frames = link_departures(arm, tolerances), base_frame(), _own_frames(measured)
    model = Model(Chain.of(arm), (base, *frames, links))
    # Order of the candidates: base, frames, targets, links.
    base_count = len(base.parameters)
    targets_at = base_count + sum(len(frame.parameters) for frame in frames)
    parameters = (
        *model.parameters[:targets_at],
        *measured.target_parameters,
        *model.parameters[targets_at:],
    )
    columns = _design_matrix(model, measured, start, targets_at)
    columns = columns.reshape(-1, len(parameters)) * [each.scale for each in parameters]
    size = np.linalg.norm(columns, axis=0)
    columns[:, size <= UNKNOWNS.no_column * size.max()] = 0.0
    kept, coefficients = _well_conditioned(columns, _independent(columns), base_count)
    names = {parameters[k].name for k in kept}  # no two parameters have one name
    target_count = len(measured.target_parameters)
    targets_kept = [k - targets_at for k in kept if 0 <= k - targets_at < target_count]
    kept_frames = [frame.only(names) for frame in frames]
    return ChosenUnknowns(
        links=links.only(names),
        frames=tuple(frame for frame in kept_frames if frame.parameters),
        base=base.only(names),
        targets_kept=np.array(targets_kept, dtype=np.intp),
        redundant=_redundant(coefficients, kept, parameters),
    )


def _own_frames(measured: Instrument) -> tuple[Offsets | OfCampaign, ...]:
    """Return the tool, or the tools and further bases of the campaigns of a group.

    A tool is part of the chain where the targets are not unknowns of their own.
    """
    if not measured.campaigns:
        return () if measured.target_parameters else (tool_frame(),)
    campaigns = tuple(enumerate(measured.campaigns))
    return (
        *(OfCampaign(base_frame(), k, name) for k, (name, _) in campaigns[1:]),
        *(
            OfCampaign(tool_frame(), k, name)
            for k, (name, part) in campaigns
            if not part.target_parameters
        ),
    )


def _design_matrix(model: Model, measured: Instrument, start: Start, targets_at: int) -> Array:
    """Return the derivative (P, b, k) of what is measured at random joint positions.

    Args:
        targets_at: column of the model's parameters before which those of the targets stand.
    """
    # Rows enough for all columns, whatever the instrument measures in one configuration.
    seen = measured.components_seen
    components = min(seen[poses, columns].shape[1] for poses, columns in measured.parts_seen)
    column_count = len(model.parameters) + len(measured.target_parameters)
    count = int(np.ceil(UNKNOWNS.rows_a_column * column_count / components))
    states = _random_states(model.chain.arm, max(count, UNKNOWNS.configurations))
    if measured.campaigns:
        # The same states in every campaign of a group that has poses, each with the first reading
        # of that campaign, whose numbers play no part.
        count, rows = len(states), np.arange(len(measured))
        campaigns = [k for k, (_, part) in enumerate(measured.campaigns) if len(part)]
        first_row = np.array([rows[poses][0] for poses, _ in measured.parts_seen])
        states = states.take(np.tile(np.arange(count), len(campaigns)))
        states = replace(states, campaign=np.repeat(campaigns, count))
        measured = measured.take(np.repeat(first_row, count))
    predicted = model.predict_with_jacobian(states, np.zeros(len(model.parameters)))
    targets_m, R = start.targets_m, start.T_instr_base[:3, :3]
    T_instr_ee = start.T_instr_base @ predicted.T_base_ee
    ideal = measured.ideal(T_instr_ee, targets_m).compare(T_instr_ee, targets_m)
    end_by_model = (R @ predicted.jacobian[:, :3], R @ predicted.jacobian[:, 3:])
    by_model = ideal.by_end @ np.concatenate(end_by_model, axis=1)
    return np.concatenate(
        [by_model[..., :targets_at], ideal.by_targets, by_model[..., targets_at:]], axis=2
    )


def _random_states(arm: Arm, count: int) -> PoseStates:
    """Return unloaded states at random joint positions: within the limits, but over one turn.

    Where the limits contain the turn about zero, it is that one, else the one about their middle.
    """
    low, high = arm.axis_limits_rad.T
    about_zero = (low <= -np.pi) & (high >= np.pi)
    middle = np.where(about_zero, 0.0, 0.5 * (low + high))
    longer = ~arm.axes_slide & (high - low > 2.0 * np.pi)
    low, high = np.where(longer, middle - np.pi, low), np.where(longer, middle + np.pi, high)
    generator = np.random.default_rng(UNKNOWNS.random_seed)
    axes_rad = generator.uniform(low, high, (count, len(low)))
    q_rad = arm.coupling.to_joints(axes_rad)
    zeros, zero = np.zeros_like(q_rad), np.zeros(count)
    return PoseStates(q_rad, zeros, zeros, zero, zero, zero)


def _independent(columns: Array) -> list[int]:
    """Return the columns, in order, that are not linear combinations of those before them."""
    basis = np.empty((columns.shape[1], len(columns)))  # its first rows are orthonormal
    kept: list[int] = []
    for k, column in enumerate(np.ascontiguousarray(columns.T)):
        before = basis[: len(kept)]
        remainder = column - (before @ column) @ before
        remainder -= (before @ remainder) @ before  # once more, against rounding
        size, length = float(column @ column) ** 0.5, float(remainder @ remainder) ** 0.5
        if size > 0.0 and length > UNKNOWNS.least_left * size:
            basis[len(kept)] = remainder / length
            kept.append(k)
    return kept


def _well_conditioned(columns: Array, kept: list[int], fixed: int) -> tuple[list[int], Array]:
    """Exchange kept columns for omitted ones that they replace only by large coefficients.

    Every exchange multiplies the volume that the unit columns span by the size of the coefficient
    (Gu and Eisenstat, 1996), so the exchanges come to an end.

    Args:
        fixed: the first columns, so many, are not exchanged.

    Returns:
        The columns kept, and the coefficients (kept, omitted) that make the omitted ones of them,
        in the units of `columns`.
    """
    size = np.linalg.norm(columns, axis=0)
    size[size == 0.0] = 1.0
    unit, with_effect = columns / size, np.flatnonzero(columns.any(axis=0))
    while True:
        omitted = [k for k in range(len(size)) if k not in kept]
        basis, triangle = np.linalg.qr(unit[:, kept])
        coefficients = np.linalg.solve(triangle, basis.T @ unit[:, omitted])
        sizes = np.abs(coefficients)
        sizes[np.array(kept) < fixed] = 0.0
        sizes[:, ~np.isin(omitted, with_effect)] = 0.0
        if not sizes.size or sizes.max() <= UNKNOWNS.most_times:
            return kept, coefficients * size[omitted] / size[kept][:, None]
        # The omitted column that is worst represented replaces the last one that represents it by a
        # large coefficient: of the candidates, those nearer the base stay.
        omitted_worst = int(np.argmax(sizes.max(axis=0)))
        kept_last = int(np.flatnonzero(sizes[:, omitted_worst] > UNKNOWNS.most_times)[-1])
        kept = sorted([*kept[:kept_last], *kept[kept_last + 1 :], omitted[omitted_worst]])


def _redundant(
    coefficients: Array, kept: list[int], parameters: tuple[TermParameter, ...]
) -> tuple[Redundant, ...]:
    """Return the parameters omitted, and those kept that replace them.

    Args:
        coefficients: (kept, omitted), of the columns in scaled parameters; those returned are in
            the units of the parameters.
    """
    omitted = [k for k in range(len(parameters)) if k not in kept]
    scale = np.array([parameter.scale for parameter in parameters])
    coefficients = (
        np.where(np.abs(coefficients) > UNKNOWNS.no_part, coefficients, 0.0)
        * scale[kept][:, None]
        / scale[omitted]
    )
    return tuple(
        Redundant(
            name=parameters[k].name,
            replaced_by={parameters[kept[j]].name: float(part[j]) for j in np.flatnonzero(part)},
        )
        for k, part in zip(omitted, coefficients.T, strict=True)
    )

"""What to measure next: configurations that best distinguish what the data so far cannot.

An effect and its rival are far apart where one, in the size found, leaves rows that the model's own
parameters and the other together cannot follow; what these cost the other is the difference in log
evidence to be expected. Either of the two may be the truth, so the lesser of both ways counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pa10cal.arrays import Array
from pa10cal.discovery.evidence.fit import Fit
from pa10cal.discovery.evidence.problem import Problem
from pa10cal.discovery.next_poses.contest import Pair, outlooks
from pa10cal.discovery.next_poses.foresee import foresee
from pa10cal.discovery.next_poses.outlook import Outlook
from pa10cal.discovery.next_poses.room import NextPose, Room, draw_admissible
from pa10cal.discovery.verdict import Plan, Separation, label_of

#: A pair that the best configurations bring apart by less (odds of 20 to 1) counts as one that
#: poses cannot distinguish.
LEAST_NATS = 3.0
_POOL = 1000


def plan(
    problem: Problem,
    found: Fit,
    rivals: Sequence[Pair],
    count: int = 10,
    random_seed: int = 0,
    room: Room | None = None,
) -> Plan:
    """Choose the configurations that best separate pairs of effects.

    Out of a pool drawn at random, one after the other, each time the one with which the closest
    pair comes furthest apart. Pairs that no such choice would split are omitted.

    Args:
        problem: the campaign.
        found: the model with what was found, fitted.
        rivals: pairs of an effect (of the fit, or not testable) and what explains the data as well
            in its place: another effect, or None for the model's own parameters alone.
        count: configurations wanted.
        random_seed: draws the pool.
        room: where arm and tool may go; the default where None.

    Raises:
        DiscoveryError: when nothing can be foreseen, or an effect needs what is not known.
    """
    if not rivals:
        return Plan((), ())
    pool = _draw(problem, room or Room(), np.random.default_rng(random_seed))
    ahead = foresee(problem, found, pool.q_rad, pool.load_N, pool.arrival)
    pairs = outlooks(problem, found, rivals, ahead)
    count = min(count, len(pool.q_rad))
    possible = [float(_choose([pair], count, [0])[1][-1, 0]) for pair in pairs]
    sought = [k for k, pair in enumerate(pairs) if possible[k] - _nats(pair) >= LEAST_NATS]
    chosen, nats = _choose(pairs, count if sought else 0, sought)
    return Plan(
        _chosen_poses(pool, chosen, nats, rivals, sought),
        tuple(
            Separation(
                *pair,
                before_nats=float(nats[0, k]),
                after_nats=float(nats[-1, k]),
                possible_nats=possible[k],
                can_be_split=possible[k] - float(nats[0, k]) >= LEAST_NATS,
            )
            for k, pair in enumerate(rivals)
        ),
    )


@dataclass(frozen=True)
class _Pool:
    """N configurations that could be measured: joint angles, loads, directions of arrival."""

    q_rad: Array
    load_N: Array
    arrival: Array


def _draw(problem: Problem, room: Room, rng: np.random.Generator) -> _Pool:
    """Draw the pool: with the least load or the largest, from either side of every joint.

    A spring that is soft near zero torque shows without load, all else that yields shows with it.
    """
    q_rad = draw_admissible(problem, _POOL, room, rng)
    load_N = problem.cells.states.load_N
    loads = np.array([load_N.min(), load_N.max()])
    return _Pool(
        q_rad, rng.choice(loads, len(q_rad)), rng.choice(np.array([-1.0, 1.0]), q_rad.shape)
    )


def _choose(
    pairs: Sequence[tuple[Outlook, ...]], count: int, sought: Sequence[int]
) -> tuple[list[int], Array]:
    """Choose configurations one after the other by the closest of the pairs sought.

    Returns:
        The configurations, and the separation (count + 1, pairs) before the first and after each.
    """
    chosen: list[int] = []
    nats = [[_nats(pair) for pair in pairs]]
    for _ in range(count):
        ahead = np.min([outlook.nats_with() for k in sought for outlook in pairs[k]], axis=0)
        ahead[chosen] = -np.inf
        chosen.append(int(np.argmax(ahead)))
        pairs = [tuple(outlook.after(chosen[-1]) for outlook in pair) for pair in pairs]
        nats.append([_nats(pair) for pair in pairs])
    return chosen, np.array(nats)


def _nats(pair: tuple[Outlook, ...]) -> float:
    return min(outlook.nats for outlook in pair)


def _chosen_poses(
    pool: _Pool, chosen: list[int], nats: Array, rivals: Sequence[Pair], sought: list[int]
) -> tuple[NextPose, ...]:
    """Return what was chosen, with the pairs it is for."""
    suggestions = []
    for order, k in enumerate(chosen):
        gained = nats[order + 1] - nats[order]
        even_share = (nats[-1] - nats[0]) / len(chosen)
        closest = min(sought, key=lambda pair: nats[order, pair])
        suggestions.append(
            NextPose(
                q_rad=pool.q_rad[k],
                load_N=float(pool.load_N[k]),
                arrival=pool.arrival[k],
                separation_nats=float(nats[order + 1, sought].min()),
                purposes=tuple(
                    label_of(*rivals[pair])
                    for pair in sought
                    if pair == closest or gained[pair] >= even_share[pair]
                ),
            )
        )
    return tuple(suggestions)

"""Summaries of made-up individuals of the study of chains."""

from types import SimpleNamespace

from pa10cal_curve.study import summaries_of

MODELS = ("two_level", "two_level_all", "general")


def individual(departs, unknowns, rank, null):
    distances = SimpleNamespace(mean_mm=0.1)
    fit = SimpleNamespace(
        scores={}, converged=True, unknowns=unknowns, rank=rank, null_directions=null
    )
    errors = SimpleNamespace(fitted=distances, held_out=distances, held_out_true=distances)
    return SimpleNamespace(
        departs=departs, models=dict.fromkeys(MODELS, fit), errors=dict.fromkeys(MODELS, errors)
    )


def test_rank_unknowns_and_null_directions_are_those_of_one_individual():
    fits = ((30, 30, ()), (30, 29, ({"delta_a_1": 1.0},)), (28, 28, ()))
    made = [individual(departs, *fit) for departs in ("rows", "any_way") for fit in fits]
    for found in summaries_of(made, 0.1):
        assert (found.unknowns, found.rank) == (30, 29)
        assert found.null_directions == ({"delta_a_1": 1.0},)

"""The best candidate is found without a fit of all."""

from pa10cal.numerics.branch_and_bound import best_candidate


def test_the_first_of_the_least_is_found_without_fitting_all():
    misfits, fitted = [5.0, 2.0, 3.0, 2.0, 9.0], []

    def fit(k: int) -> float:
        fitted.append(k)
        return misfits[k]

    assert best_candidate([4.0, 1.5, 2.5, 1.0, 8.0], fit, 10.0) == (2.0, 1)
    assert sorted(fitted) == [1, 3]
    assert best_candidate([4.0, 1.5, 2.5, 1.0, 8.0], fit, 1.9) is None

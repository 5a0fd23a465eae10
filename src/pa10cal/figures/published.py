"""What the paper states, each with the place where it stands; nothing here comes from a run.

C. Lightcap, S. Hamner, T. Schmitz, S. Banks, "Improved Positioning Accuracy of the PA10-6CE Robot
with Geometric and Flexibility Calibration", IEEE Transactions on Robotics, 2008.
"""

from __future__ import annotations

from dataclasses import dataclass

from pa10cal.reports.results_bundle import ResultsBundle

#: Description of the arm the paper is about; its parameters are compared with no other arm's.
ROBOT = "pa10_6ce"


@dataclass(frozen=True)
class PublishedError:
    """Errors over a set of configurations."""

    # mean_mm and peak_mm: position error
    mean_mm: float
    peak_mm: float
    orientation_deg: float  # mean orientation error


#: Errors by load of the 27 grid configurations.
BEFORE = {
    "0N": PublishedError(0.58, 1.22, 1.2),
    "22N": PublishedError(1.02, 1.50, 1.2),
    "44N": PublishedError(1.80, 2.45, 1.1),
}
AFTER = {
    "0N": PublishedError(0.32, 0.66, 0.05),
    "22N": PublishedError(0.28, 0.58, 0.04),
    "44N": PublishedError(0.33, 0.71, 0.03),
}
#: Upper bound of the standard deviation within one configuration [mm], by load.
REPEATABILITY_MM = {"0N": 0.014, "22N": 0.024, "44N": 0.023}
#: Errors of the ten held-out configurations, by model.
HELD_OUT = {
    "uncalibrated": PublishedError(1.77, 4.0, 2.4),
    "linear": PublishedError(0.55, 0.92, 1.2),
    "cubic": PublishedError(0.56, 1.04, 1.2),
}

#: Monte Carlo in the plane z = 500 mm; 300 and 700 mm differ by less than the last figure [mm].
MONTE_CARLO_PLANE_MM = 500
MONTE_CARLO_MEAN_MM = 0.197
MONTE_CARLO_STD_MM = 0.096
MONTE_CARLO_PARALLEL_PLANES_MM = (300, 700)
MONTE_CARLO_PLANES_DIFFER_MM = 0.001

#: Apparatus [mm].
CMM_UNCERTAINTY_MM = 0.0121
APPARATUS_SAG_MM = 0.030
TOUCH_DEFLECTION_MM = 0.001

#: Claims of the conclusion and of Section III.C: largest distance of the errors after calibration
#: from the Monte Carlo mean [mm], range of the reductions of the mean errors, and least reduction
#: of the held-out peak errors.
CLAIMED_DISTANCE_FROM_MINIMUM_MM = 0.1
CLAIMED_REDUCTIONS_PERCENT = (50, 80)
CLAIMED_PEAK_REDUCTION_PERCENT = 75

#: Link departures of Table I [m, rad]. The Hayati angle stands in the row of joint 2.
DEPARTURES = {
    "delta_a_1": 0.33e-3,
    "delta_a_2": -0.46e-3,
    "delta_a_3": 1.09e-3,
    "delta_a_4": -0.48e-3,
    "delta_a_5": -0.30e-3,
    "delta_a_6": -3.44e-3,
    "delta_alpha_1": -4.9e-4,
    "delta_alpha_2": 1.2e-4,
    "delta_alpha_3": -2.3e-3,
    "delta_alpha_4": 2.1e-4,
    "delta_alpha_5": 3.7e-5,
    "delta_alpha_6": -7.1e-4,
    "delta_d_1": 0.09e-3,
    "delta_d_3": 1.26e-3,
    "delta_d_4": 0.22e-3,
    "delta_d_5": 0.10e-3,
    "delta_d_6": 0.17e-3,
    "delta_beta_2": -1.0e-3,
    "delta_theta_1": -5.9e-3,
    "delta_theta_2": -7.8e-3,
    "delta_theta_3": 2.9e-3,
    "delta_theta_4": 8.1e-3,
    "delta_theta_5": -1.5e-3,
    "delta_theta_6": 1.3e-2,
}
#: Linear stiffness by joint [N m/rad].
K_LIN = {2: 1.98e4, 3: 1.27e4, 5: 2.56e3}
#: Cubic stiffness by joint [N m/rad^3]: Section III.B and Table I differ by a power of ten.
K_CUB = {
    "text_e7": {2: 3.35e7, 3: 1.46e7, 5: 3.83e7},
    "table_e8": {2: 3.35e8, 3: 1.46e8, 5: 3.84e8},
}

#: Where in the paper a group of figures stands.
SOURCES = {
    "before_after": "Section III.B, Fig. 5",
    "repeatability": "Section III.B",
    "orientation": "Section III.B",
    "held_out": "Section III.C, Fig. 6",
    "monte_carlo": "Section III.A",
    "k_lin": "Section III.B, Table I",
    "text_e7": "Section III.B (Table I: 1e8)",
    "table_e8": "Table I (Section III.B: 1e7)",
    "departures": "Table I",
    "cmm": "Section II.B",
    "apparatus": "Section II.B",
    "conclusion": "Section IV",
    "unknowns": "Section II.C",
}


def is_of_papers_arm(results: ResultsBundle) -> bool:
    """Return whether the arm is the paper's, so that its figures may stand beside the results."""
    return results.description is not None and results.description.robot == ROBOT


def parameter(name: str, kcub_reading: str) -> float | None:
    """Return the paper's value of one of our parameters [SI], None where it states none."""
    kind, _, joint = name.rpartition("_")
    if kind == "K_lin":
        return K_LIN.get(int(joint))
    if kind == "K_cub":
        return K_CUB[kcub_reading].get(int(joint))
    return DEPARTURES.get(name)


def reduction_percent(before: float, after: float) -> float:
    """Return by how much an error fell, in percent of what it was."""
    return 100.0 * (1.0 - after / before)

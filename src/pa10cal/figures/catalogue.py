"""Names of the figures and tables; each is a module of this package."""

from __future__ import annotations

#: Modules with `draw(results) -> Figure`.
FIGURES = (
    "health",
    "fig4_test_path",
    "fig5_before_after",
    "fig6_holdout",
    "residual_vectors",
    "parameter_uncertainty",
    "l_curve",
    "montecarlo_planes",
    "montecarlo_convergence",
    "montecarlo_map",
    "held_out_errors",
    "error_by_joint",
    "where_breakdown",
    "where_joints",
    "where_torque",
    "joint_error_maps",
    "gap_by_step",
    "residual_field",
    "parameter_shifts",
)
#: Modules with `tabulate(results) -> Table`.
TABLES = (
    "health_summary",
    "table1_parameters",
    "paper_against_ours",
    "parameters_general",
    "suspected_outliers",
    "accuracy_general",
    "verdict",
)
#: Modules with `draw(scores) -> Figure`, of a study of blind trials.
TRIAL_FIGURES = ("trials_confusion", "trials_power", "trials_false_names", "trials_intervals")
#: Modules with `tabulate(scores) -> Table`, of a study of blind trials.
TRIAL_TABLES = ("trials_summary",)
#: Modules with `draw(drawing) -> Figure`, of a shape and of a gait that a chain was laid along.
CURVE_DRAWINGS = ("curve_shape", "curve_gait")
#: Modules of the study of a chain posed along curves: `draw(study) -> Figure` ...
CURVE_FIGURES = ("curve_calibration",)
#: ... and `tabulate(study) -> Table`.
CURVE_TABLES = ("curve_calibration_summary",)

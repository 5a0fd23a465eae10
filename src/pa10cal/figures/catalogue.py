"""Names of the figures and tables; each is a module of this package."""

from __future__ import annotations

#: Modules with `draw(results) -> Figure`.
FIGURES = (
    "fig4_test_path",
    "fig5_before_after",
    "fig6_holdout",
    "residual_vectors",
    "parameter_uncertainty",
    "l_curve",
    "montecarlo_planes",
    "montecarlo_convergence",
    "montecarlo_map",
)
#: Modules with `tabulate(results) -> Table`.
TABLES = ("table1_parameters", "paper_against_ours")

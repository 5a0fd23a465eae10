"""Draws docs/architecture.svg from the project's own imports: `python docs/_site/structure.py`.

Every box is a package within `pa10cal`, or one beside it. It stands above all that it imports; an
arrow is drawn only where no longer way leads to the same package. The row at the top is the way of
a campaign: its stages in order, and what each one's command imports.
"""

from __future__ import annotations

import ast
import textwrap
from collections import defaultdict
from functools import cache
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt

from pa10cal.stages.pipeline import stages

ROOT = Path(__file__).parents[2] / "src/pa10cal"
PICTURE = Path(__file__).parents[1] / "architecture.svg"
#: What proves the product, and what is a room of its own beside it.
BESIDE = {"datasets"} | {path.name for path in ROOT.parent.glob("pa10cal_*")}
WIDTH, STAGE, LAYER = 2.6, 1.9, 0.85  # of a package, of a stage and of a layer, in inches
COLOURS = {"stage": "#0072B2", "product": "#DCE9F2", "beside": "#F3E3C3"}

Graph = dict[str, set[str]]


def modules_imported(file: Path) -> set[str]:
    """Return every module of the project that a file imports, those for types included."""
    names = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("pa10cal"):
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names if alias.name.startswith("pa10cal")}
    return names


def package_of(module: str) -> str | None:
    """Return the package of a module; None for the single modules at the top."""
    first, *rest = module.split(".")
    if first != ROOT.name:
        return first
    return rest[0] if rest and (ROOT / rest[0]).is_dir() else None


def packages() -> Graph:
    """Return what every package imports of the others."""
    places = (*ROOT.glob("*/__init__.py"), *ROOT.parent.glob("pa10cal_*/__init__.py"))
    graph: Graph = {}
    for place in sorted(places):
        files = place.parent.rglob("*.py")
        names = {name for file in files for name in map(package_of, modules_imported(file)) if name}
        graph[place.parent.name] = names - {place.parent.name}
    return graph


def layers(graph: Graph) -> dict[str, int]:
    """Return how many packages stand below each, one upon the other."""

    @cache
    def layer(package: str) -> int:
        return max((1 + layer(below) for below in graph[package]), default=0)

    return {package: layer(package) for package in graph}


def reduced(graph: Graph) -> Graph:
    """Return the arrows without those that a longer way makes superfluous."""

    @cache
    def reachable(package: str) -> frozenset[str]:
        return frozenset().union(*(reachable(below) | {below} for below in graph[package]))

    return {
        package: below - set().union(*(reachable(other) for other in below))
        for package, below in graph.items()
    }


def stage_packages() -> dict[str, set[str]]:
    """Return the stages of a campaign in order, and the packages that each one's module imports."""
    way = {}
    for stage in stages((Path("raw"),), Path("results")):
        names = modules_imported(ROOT / "stages" / f"{stage.module}.py")
        if any(name.startswith("pa10cal.stages.inputs.") for name in names):
            names |= modules_imported(ROOT / "stages/inputs.py")
        way[stage.name] = set(filter(None, map(package_of, names))) - {"stages"}
    return way


def box(axes: plt.Axes, at: tuple[float, float], text: str, colour: str, dark: bool) -> None:
    """Draw a box with its name."""
    axes.text(
        *at,
        text,
        ha="center",
        va="center",
        fontsize=11,
        color="white" if dark else "black",
        bbox={"boxstyle": "round,pad=0.45", "facecolor": colour, "edgecolor": "#555555"},
        zorder=3,
    )


def main() -> None:
    """Draw the picture."""
    graph, way = packages(), stage_packages()
    graph.pop("stages")
    graph = {package: below - {"stages"} for package, below in graph.items()}
    at_layer: dict[int, list[str]] = defaultdict(list)
    for package, layer in layers(graph).items():
        at_layer[layer].append(package)
    width = max(*(WIDTH * len(row) for row in at_layer.values()), STAGE * len(way))
    place: dict[str, tuple[float, float]] = {}
    arrows = reduced(graph)
    for layer, row in sorted(at_layer.items()):
        # Beside the middle of what a package stands upon, so that arrows are short.
        below = {p: [place[q][0] for q in arrows[p]] for p in row}
        row.sort(key=lambda p: (sum(below[p]) / len(below[p]) if below[p] else 0.0, p))
        for n, package in enumerate(row):
            place[package] = ((n - (len(row) - 1) / 2) * width / len(row), layer)
    top = max(at_layer) + 1.9
    mpl.rcParams |= {
        "svg.hashsalt": "pa10cal",
        "font.family": "DejaVu Sans",
        "svg.fonttype": "none",
    }
    figure, axes = plt.subplots(figsize=(width, LAYER * (top + 1.5)))
    axes.set_axis_off()
    for package, below in arrows.items():
        for other in sorted(below):
            axes.annotate(
                "",
                place[other],
                place[package],
                arrowprops={"arrowstyle": "->", "color": "#999999", "shrinkA": 14, "shrinkB": 16},
            )
    for package, at in place.items():
        box(axes, at, f"{package}/", COLOURS["beside" if package in BESIDE else "product"], False)
    for n, (stage, used) in enumerate(way.items()):
        at = ((n - (len(way) - 1) / 2) * width / len(way), top)
        box(axes, at, stage, COLOURS["stage"], True)
        names = ", ".join(sorted(used - {"files", "results"}))
        axes.text(at[0], top - 0.33, textwrap.fill(names, 20), ha="center", va="top", fontsize=9)
        if n:
            axes.annotate(
                "",
                (at[0] - 0.62, top),
                (at[0] - width / len(way) + 0.62, top),
                arrowprops={"arrowstyle": "-|>", "color": COLOURS["stage"], "lw": 1.5},
            )
    axes.set_xlim(-width / 2, width / 2)
    axes.set_ylim(-0.5, top + 0.4)
    figure.savefig(PICTURE, bbox_inches="tight", metadata={"Date": None})


if __name__ == "__main__":
    main()

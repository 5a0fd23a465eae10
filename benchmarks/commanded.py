"""Simulated robots, commanded through their calibrated models and measured again.

Writes `benchmarks/commanded.md` and its figure, which the README shows as well: errors before and
after, and what the models promise.
"""

from __future__ import annotations

from pathlib import Path

from pa10cal.commands.command_line import limit_threads
from pa10cal.files.output import whole_file, write_text

HERE = Path(__file__).parent
FIGURES = (HERE / "commanded.svg", HERE.parent / "docs/commanded.png")
NOISE_MM, TARGETS, LOAD_N = 0.03, 60, 0.0
#: What is commanded: instrument, robot, joints with springs, effects hidden and known.
CASES = {
    "UR10, positions and orientations": ("pose", "ur10", (), ()),
    "IRB 120, three reflectors": ("points", "irb120", (), ()),
    "iiwa 14, three reflectors": ("points", "iiwa14", (), ()),
    "UR10, two springs, gear ratio, transmission error": (
        "pose",
        "ur10",
        (2, 3),
        (
            ("gear_ratio_error", "joint 3", {"eps": 4e-4}),
            ("transmission_error", "joint 2", {"A": 3e-4, "phi": 0.5}),
        ),
    ),
    "PA10, five springs, gear ratio, bending forearm": (
        "pose",
        "pa10_6ce",
        (1, 2, 3, 4, 5),
        (
            ("gear_ratio_error", "joint 3", {"eps": 4e-4}),
            ("link_bending", "forearm", {"c": 8e-6}),
        ),
    ),
}


def main() -> None:
    limit_threads()
    import numpy as np

    found = {name: commanded(*case) for name, case in CASES.items()}
    lines = [
        "# Commanded through the model, measured again",
        "",
        f"`make commanded`: simulated robots, measured in 110 poses with noise of {NOISE_MM:g} mm",
        f"and calibrated, then sent to {TARGETS} new targets: as designed, and by `compensate`.",
        "Distances of the true tool from its target, root mean square over the targets that are",
        "reached [mm]; promised is the standard uncertainty that the model states.",
        "",
        "![errors before and after](commanded.svg)",
        "",
        "| robot, instrument, effects | before | after | promised | largest after | reached |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for name, one in found.items():
        ok = np.isin(one.status, ["ok", "near_singular"])
        before, after, promised = (
            float(np.sqrt(np.mean(each[ok] ** 2)))
            for each in (one.before_mm, one.after_mm, one.promised_mm)
        )
        lines.append(
            f"| {name} | {before:.2f} | {after:.3f} | {promised:.3f} | "
            f"{one.after_mm[ok].max():.3f} | {ok.sum()} of {len(ok)} |"
        )
    draw(found, *FIGURES)
    text = "\n".join(lines) + "\n"
    write_text(HERE / "commanded.md", text)
    print(text)


def commanded(instrument, robot, flexible, hidden):
    """Measure, calibrate and command a robot."""
    import numpy as np

    from benchmarks.planned import command, simulated_model
    from pa10cal.calibration.options import EffectOfPlace
    from pa10cal_lab.cell.options import HiddenEffectOptions, SimulateOptions, TrackerOptions

    plan = TrackerOptions(
        instrument=instrument,
        poses=110,
        holdout_share=0.1,
        repeat_every=2 if hidden else 0,
        position_mm=NOISE_MM,
        attitude_rad=1e-4,
        flexible_joints=flexible,
    )
    effects = tuple(HiddenEffectOptions(id=n, of=of, parameters=p) for n, of, p in hidden)
    settings = SimulateOptions(
        random_seed=5, robot=robot, without_touches=plan, hidden_effects=effects
    )
    known = [EffectOfPlace(id=name, of=of) for name, of, _ in hidden]
    made, _, model = simulated_model(settings, known)
    low, high = np.clip(model.arm.limits_rad, -2.6, 2.6).T
    q = np.random.default_rng(9).uniform(low, high, (TARGETS, len(low)))
    return command(made, model, q, LOAD_N)


def draw(found, *paths: Path) -> None:
    """Draw the errors of every target, before and after, and what was promised."""
    import matplotlib as mpl
    import numpy as np

    mpl.use("agg")
    from matplotlib import pyplot as plt

    mpl.rcParams["svg.hashsalt"] = "commanded"
    figure, axes = plt.subplots(figsize=(7.2, 3.6), layout="constrained")
    for place, one in enumerate(found.values()):
        ok = np.isin(one.status, ["ok", "near_singular"])
        spread = np.random.default_rng(0).uniform(-0.3, 0.3, int(ok.sum()))
        for values, mark, colour, label in (
            (one.before_mm, "o", "#b35806", "before: commanded as designed"),
            (one.after_mm, "s", "#2166ac", "after: commanded through the model"),
        ):
            look = {"color": colour, "marker": mark, "markersize": 2.6, "linestyle": "none"}
            axes.plot(place + spread, values[ok], label=label if not place else None, **look)
        promised = float(np.sqrt(np.mean(one.promised_mm[ok] ** 2)))
        told = "promised: standard uncertainty" if not place else None
        axes.plot([place - 0.4, place + 0.4], [promised] * 2, "k--", linewidth=1.4, label=told)
    axes.set_yscale("log")
    axes.set_ylabel("distance from the target [mm]")
    axes.set_xticks(range(len(found)), [name.replace(", ", ",\n") for name in found], fontsize=7)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 1.16), ncols=3, fontsize=7, frameon=False)
    axes.grid(axis="y", linewidth=0.3)
    for path in paths:
        undated = {"Date": None} if path.suffix == ".svg" else {"Software": None}
        with whole_file(path) as beside:
            figure.savefig(beside, metadata=undated, dpi=130)
    plt.close(figure)


if __name__ == "__main__":
    main()

"""Commands that write simulated campaigns: `simulate`, `draw_trials`."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pa10cal_lab.cell.options import SimulateOptions


def simulate(
    *,
    name: str,
    out: Path,
    truth: Path,
    kcub_reading: Literal["text_e7", "table_e8"] = "text_e7",
    settings: SimulateOptions = SimulateOptions(),
) -> None:
    """Write a campaign with the virtual cell.

    Args:
        name: name of the campaign.
        out: folder of the campaign.
        truth: file for what is hidden in it.
        kcub_reading: exponent of the paper's cubic stiffness.
        settings: an entry of section simulate.

    Examples:
        pa10cal simulate --name mine --out data/raw/mine --truth truth.json
        pa10cal simulate --name mine --out data/raw/mine --truth truth.json --settings \\
          '{"robot": "ur10", "without_touches": {}}'
    """
    from pa10cal.errors import SettingsError
    from pa10cal.files.arms import arm_asked
    from pa10cal_lab.cell.campaign import simulate_campaign
    from pa10cal_lab.cell.write import write_campaign

    if not name:
        raise SettingsError(
            "the campaign has no name",
            where="--name",
            value=name,
            allowed="a text of at least one letter",
            remedy="give it a name",
        )
    arm = arm_asked(settings.robot)
    write_campaign(simulate_campaign(name, arm, settings, kcub_reading), out, truth)
    print(f"{name}: {arm.title} in {out}, what is hidden in {truth}")


def draw_trials(
    *,
    kind: str,
    count: int,
    random_seed: int,
    raw: Path,
    truths: Path,
    first: int = 0,
    benches: str = "",
    only: str = "",
) -> None:
    """Write the raw folders of wild trials, and what is in them apart.

    Args:
        kind: right, stressed, effect, beyond, fault, unstated_masses, sorted_rows or mixed.
        count: how many.
        random_seed: draws robots, poses, noise, and what is put in.
        raw: gets one raw folder a trial.
        truths: gets one file a trial with what is in it (.json).
        first: number of the first of them.
        benches: arms under instruments such as ur10-pose, or pa10-touched, with commas between
            them; all of them where none are given.
        only: one disturbance or effect, or what unstated_masses hide, such as some_springs; all in
            turn where none is given.

    Examples:
        pa10cal draw_trials --kind fault --count 3 --random-seed 1 --raw wild --truths truths
    """
    from pa10cal.files.arms import load_arm
    from pa10cal_lab.cell.campaign import simulate_campaign
    from pa10cal_lab.cell.trials import draw_trials as draw
    from pa10cal_lab.cell.write import write_campaign

    names = tuple(name.strip() for name in benches.split(",") if name.strip())
    for trial in draw(kind, count, random_seed, "wild", names, first=first, only=only):
        made = simulate_campaign(trial.name, load_arm(trial.settings.robot), trial.settings)
        truth = truths / f"{trial.name}.json"
        truth.parent.mkdir(parents=True, exist_ok=True)
        places = write_campaign(made, raw / trial.name, truth)
        what = [
            *(f"{entry.id} of {entry.of}" for entry in trial.settings.hidden_effects),
            *(
                f"{entry.id} at {', '.join(where)}"
                for entry, where in zip(trial.settings.disturbances, places, strict=True)
            ),
        ]
        print(f"{raw / trial.name}: {trial.bench}: {'; '.join(what) or 'nothing'}")

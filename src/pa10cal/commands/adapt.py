"""Command `adapt`."""

from __future__ import annotations

from pathlib import Path


def adapt(
    *,
    prior: Path,
    campaign_dir: Path,
    poses: Path,
    out: Path,
    shares: tuple[float, ...] = (0.01, 0.03, 0.1, 0.3, 0.7),
    figures: Path | None = None,
    force: bool = False,
) -> None:
    """Show how many poses of a campaign a model of another campaign needs.

    Args:
        prior: model.yaml of the same arm, or the results that hold it.
        campaign_dir: folder of raw files of the campaign to adapt to.
        poses: its table of poses (.parquet).
        out: errors by number of poses, to write (.json).
        shares: parts of all its configurations to fit, the first in order of time.
        figures: folder for a figure of the same name.
        force: take a prior whatever its grade.

    Examples:
        pa10cal adapt --prior results/ur10-a --campaign-dir data/raw/ur10-c --poses \\
          results/ur10-c/ingest/poses.parquet --out adapted_ur10-a.json
    """
    from functools import partial

    from pa10cal.calibration.general.prior import refuse_unsound
    from pa10cal.campaign.description import read_description
    from pa10cal.campaign.table import read_observations
    from pa10cal.campaign.weighed_arm import arm_of
    from pa10cal.errors import SettingsError
    from pa10cal.evaluation.adapted import adapted_steps
    from pa10cal.fit.model_file import load_model
    from pa10cal.results.codec import write
    from pa10cal.results.comparison import AdaptationRecord

    if not all(0.0 < share <= 1.0 for share in shares):
        raise SettingsError(
            "shares that are no parts of a campaign",
            where="--shares",
            value=shares,
            allowed="numbers above 0 and up to 1",
            remedy="correct the list",
        )
    campaign = read_description(campaign_dir)
    model = load_model(prior)
    refuse_unsound(model, force=force)
    every = read_observations(poses, campaign)
    arm = arm_of(campaign, campaign_dir, every)
    say = partial(print, flush=True)
    steps = adapted_steps(model, arm, every, campaign.payload(arm), shares, say)
    record = AdaptationRecord(
        campaign=campaign.name,
        provenance=campaign.provenance,
        from_=None if model.fitted_to is None else model.fitted_to.campaign,
        held_out=steps[0].prior.configurations,
        steps=steps,
    )
    write(record, out)
    if figures is not None:
        from pa10cal.figures.options import FigureOptions
        from pa10cal.figures.over_campaigns import write_adaptation

        write_adaptation(record, figures, out.stem, FigureOptions().png_dpi)

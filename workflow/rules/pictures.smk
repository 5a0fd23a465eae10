"""Which pictures a campaign has, and the results they are drawn from."""

from pa10cal.planning.measured import has_held_out, has_repeats

EVALUATED = f"calibration/{SETTINGS.evaluation.calibration}.json"


def table_of_poses(campaign):
    return Path(checkpoints.ingest.get(campaign=campaign).output.poses)


def holds_out(campaign):
    """Whether a campaign has poses that no fit sees."""
    return has_held_out(table_of_poses(campaign))


def sees_positions(campaign):
    """Whether its instrument sees where the arm is; of a distance, one number tells too little."""
    if campaign in IMPORTED:
        return True
    return instrument_kind(Path(SETTINGS.raw_dir, campaign)) != "distance"


def judges_by_repeats(campaign):
    """Whether effects are judged by repeats of a pose."""
    return seeks_effects(campaign) and has_repeats(table_of_poses(campaign))


def judges_by_blocks(campaign):
    """Whether effects are judged by poses left out, where none was measured again."""
    return seeks_effects(campaign) and not has_repeats(table_of_poses(campaign))


def general_of(campaign):
    """The calibration with the general model: the combined one, or that beside the paper's."""
    load = "combined" if by_general_model(campaign) else "general"
    return results_of(campaign, [f"calibration/{load}.json"])


def gaps_of(campaign):
    """What residual vectors are drawn from: discovery, or the calibration where there is none."""
    names = [EVALUATED, "discovery/analysis.json"]
    return results_of(campaign, names if seeks_effects(campaign) else ["calibration/combined.json"])


def accuracies_of(campaign):
    """What the errors of every model are told from."""
    names = ["calibration/combined.json", EVALUATED, "evaluation/holdout.json"]
    return [*results_of(campaign, dict.fromkeys(names)), *verdict_of(campaign)]


def results_of(campaign, names):
    return [path for name in names for path in expand(result(name), campaign=campaign)]


# What is known of a campaign only once its poses are.
BY_POSES = {holds_out, judges_by_repeats, judges_by_blocks}


def pictures_of(campaign):
    """The figures and tables of a campaign, which follow from what it is."""
    return [*pictures_by_description(campaign), *pictures_by_poses(campaign)]


def pictures_by_description(campaign):
    """Those that its description alone decides upon: they can be planned before ingest has run."""
    return _pictures(campaign, by_poses=False)


def pictures_by_poses(campaign):
    """Those that its poses decide upon."""
    return _pictures(campaign, by_poses=True)


def _pictures(campaign, by_poses):
    return [
        path
        for pattern, pictures in (("figures/{}.svg", FIGURES), ("tables/{}.csv", TABLES))
        for name, picture in pictures.items()
        if bool(BY_POSES & set(picture["of"])) is by_poses
        and all(holds(campaign) for holds in picture["of"])
        for path in results_of(campaign, [pattern.format(name)])
    ]

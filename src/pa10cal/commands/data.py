"""Commands for files, arms and data: `columns`, `import`, `fetch`, `import_arm`, `effects`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pa10cal.options import IngestOptions

if TYPE_CHECKING:
    from pa10cal.arm.description import Arm


def columns(
    files: tuple[Path, ...],
    *,
    robot: str | None = None,
    name: str | None = None,
    arms: Path | None = None,
) -> None:
    """Propose how to read a tracker's or controller's export as it is: a campaign.yaml for it.

    Encoding, separator, decimal sign and columns are recognised by the header and the numbers; with
    --robot units and the convention of orientations by the kinematics of the nominal arm too, and
    the file is read once with them. A log of joints and a log of readings are joined by labels, by
    time (the clocks may differ) or by row. The output lists the meaning of every column. Save it as
    campaign.yaml beside the file, correct it, and use pa10cal run.

    Args:
        files: one with a row a configuration, joint positions and what was measured; or two, the
            joints in one and the readings in the other.
        robot: name of the arm: of a description beside the file (also as NAME.yaml, or its path),
            of a shipped one, or of robot_descriptions.
        name: name of the campaign; without it, that of the folder.
        arms: folder of arm descriptions; without it, `arms` beside the folder of the files.

    Examples:
        pa10cal columns examples/ur10-pose/tracker.txt --robot ur10
        pa10cal columns measured/export.csv --robot ur10 > measured/campaign.yaml
        pa10cal columns measured/controller.csv measured/tracker.csv --robot ur10
    """
    import sys

    from pa10cal.campaign.file_roles import follows_contract
    from pa10cal.campaign.propose import propose, propose_two_logs
    from pa10cal.campaign.sniffing import sniff
    from pa10cal.errors import SettingsError, one_line
    from pa10cal.files import arm_places
    from pa10cal.files.arms import joint_names, load_arm

    if len(files) > 2 or len({file.absolute().parent for file in files}) > 1:
        raise SettingsError(
            "too many files" if len(files) > 2 else "the two logs are not in one folder",
            where="columns",
            value=", ".join(map(str, files)),
            allowed="one file, or the joints' log and the readings' log in one folder",
            remedy="give one or two files of the campaign's folder",
        )
    folder = files[0].parent
    arm: Arm | None = None
    names: tuple[str, ...] = ()
    if robot is not None:
        places = [place.resolve() for place in arm_places(folder, arms)]
        if Path(robot).resolve().parent in places:  # a path, as a shell completes it
            robot = Path(robot).name
        robot = robot.removesuffix(".yaml")
        arm = load_arm(robot, folder, arms)
        names = joint_names(robot, folder, arms)
    label, robot_name = name or label_of(folder.absolute().name), robot or "my_arm"
    sniffed = [sniff(file) for file in files]
    if len(files) == 2:
        logs, paths = (sniffed[0], sniffed[1]), (files[0], files[1])
        proposal = propose_two_logs(logs, paths, label, robot_name, arm, names)
    else:
        proposal = propose(sniffed[0], files[0].name, label, robot_name, arm, names)
        rotation = proposal.content["columns"]["poses"].get("rotation", {})
        if follows_contract(sniffed[0]) and "inverse" not in rotation:
            del proposal.content["columns"]  # files with the names of our own need none
    text = _yaml_text(proposal.content)
    comments = list(proposal.known)
    if arm is not None:
        comments += [*arm.remarks, *_comments_of_a_trial_reading(files, text, arm)]
    comments += [*proposal.read_as, *(f"check {remark}" for remark in proposal.checks)]
    print("\n".join(one_line(f"# {comment}") for comment in comments))
    print(text, end="")
    if sys.stdout.isatty():
        print(f"\nSave this as {folder / 'campaign.yaml'}, correct it, and then:")
        print(f"  pa10cal run {folder}")


def label_of(folder: str) -> str:
    """Return a name for a campaign that `run` accepts, from the name of its folder."""
    from pa10cal.errors import LONGEST_NAME, fits_a_folder
    from pa10cal.settings import RESERVED

    letters = "".join(letter if fits_a_folder(f"a{letter}") else "-" for letter in folder)
    label = letters[:LONGEST_NAME].strip("-_.") or "mine"
    return f"my-{label}" if label in RESERVED else label


def _yaml_text(content: object) -> str:
    """Return the text of a campaign.yaml; characters are escaped if one would not be visible."""
    import yaml

    from pa10cal.errors import visible

    style: dict[str, Any] = {"sort_keys": False, "default_flow_style": None, "width": 90}
    text: str = yaml.safe_dump(content, **style, allow_unicode=True)
    return text if text == visible(text) else str(yaml.safe_dump(content, **style))


def _comments_of_a_trial_reading(files: tuple[Path, ...], text: str, arm: Arm) -> list[str]:
    """Read copies of files by the text of a campaign.yaml; return comments on how that went."""
    from collections import Counter
    from shutil import copyfile
    from tempfile import TemporaryDirectory

    from pa10cal.campaign.description import DESCRIPTION_FILE
    from pa10cal.campaign.read import read_campaign
    from pa10cal.errors import Pa10calError
    from pa10cal.files.arms import arm_text
    from pa10cal.input_files import names_beside
    from pa10cal.reports.formatting import count

    with TemporaryDirectory() as name:
        folder = Path(name)
        (folder / DESCRIPTION_FILE).write_text(text, encoding="utf-8")
        (folder / f"{arm.name}.yaml").write_text(arm_text(arm), encoding="utf-8")
        for file in files:
            copyfile(file, folder / file.name)  # not linked: links out of a folder are not followed
            if (names_file := names_beside(file)) is not None:
                copyfile(names_file, folder / names_file.name)
        try:
            campaign = read_campaign(folder)
        except Pa10calError as error:
            without_copies = str(error).replace(f"{folder}/", "")
            return [f"check all of it: it is refused: {without_copies}"]
    unusable = campaign.quarantined
    reasons = Counter(row.reason for row in unusable).most_common()
    # Of the notes only those on how logs were joined and joints moved by turns, in their words.
    joined_by = (" joined by ", " by whole turns")
    return [
        f"read so: {len(campaign.observations)} rows can be used, {len(unusable)} cannot",
        *(f"cannot be used: {count(rows, 'row')}: {reason}" for reason, rows in reasons),
        *(note for note in campaign.notes if any(words in note for words in joined_by)),
        *(f"check: {warning}" for warning in campaign.warnings),
    ]


#: Rows left out that are shown one by one; all of them are in the campaign's left_out.csv.
_MOST_ROWS_SHOWN = 10


def import_data(
    dataset: str,
    folder: Path,
    *,
    out: Path,
    any_version: bool = False,
    only: tuple[str, ...] = (),
    settings: IngestOptions = IngestOptions(),
) -> None:
    """Turn a data set of another layout into campaigns.

    Args:
        dataset: name of the data set.
        folder: folder of its files.
        out: folder of campaigns to write to.
        any_version: accept files that are not the published ones, and note it in the provenance.
        only: names of the campaigns to write; all of them unless given.
        settings: section ingest.

    Examples:
        pa10cal import ipa-robot-accuracy data/ipa --out data/raw
    """
    from pa10cal.datasets.data_set import AsItIs
    from pa10cal.datasets.importing import import_campaigns, write_campaigns
    from pa10cal.datasets.readers import dataset_named
    from pa10cal.errors import RawDataError

    campaigns = import_campaigns(
        dataset_named(dataset),
        folder,
        max_left_out=settings.max_quarantined_fraction,
        any_version=any_version,
    )
    names = [campaign.name for campaign in campaigns]
    if unknown := [name for name in only if name not in names]:
        raise RawDataError(
            "the data set has no such campaign",
            where="--only",
            value=", ".join(unknown),
            allowed=", ".join(names),
            remedy="correct the name",
        )
    if only:
        campaigns = tuple(campaign for campaign in campaigns if campaign.name in only)
    for campaign, written in zip(campaigns, write_campaigns(campaigns, out), strict=True):
        readings, left_out = campaign.readings, campaign.left_out
        outcome = f"{len(left_out)} rows left out"
        if isinstance(readings, AsItIs):
            outcome = f"{readings.path.name}, read as it is"
        print(f"{written}: {'; '.join([outcome, *campaign.notes])}")
        for row in left_out[:_MOST_ROWS_SHOWN]:
            print(f"  left out: {row.file}:{row.line}: {row.reason} {row.value}".rstrip())
        if len(left_out) > _MOST_ROWS_SHOWN:
            print(f"  … and {len(left_out) - _MOST_ROWS_SHOWN} more in {written / 'left_out.csv'}")


def fetch(dataset: str, *, out: Path, source: str | None = None) -> None:
    """Fetch a public data set from its owner, of the pinned version, and check it.

    Its licence, or that none is stated, is printed before anything is fetched.

    Args:
        dataset: name of the data set.
        out: folder for its files.
        source: folder or address to take them from, if not where they are published.

    Examples:
        pa10cal fetch ipa-robot-accuracy --out data/ipa
        pa10cal fetch ipa-robot-accuracy --out data/ipa --source /media/copy
    """
    from pa10cal.datasets.fetching import fetch as fetch_files
    from pa10cal.datasets.readers import dataset_named

    data_set = dataset_named(dataset)
    print(data_set.published.terms, flush=True)
    fetched = fetch_files(data_set, out, source or None)  # an empty one, of a script, is none
    print(f"{out}: {', '.join(fetched) or 'nothing to fetch'}; all checksums are right")


def import_arm(
    file: Path,
    *,
    out: Path,
    base: str | None = None,
    tip: str | None = None,
    xacro: tuple[str, ...] = (),
    robot: str | None = None,
) -> None:
    """Turn a URDF, or a UR's calibration by its maker, into an arm description.

    Forward kinematics of description and URDF is compared. A copy of the URDF is put beside the
    description, so that a calibrated model can be exported as the same URDF with calibrated
    origins.

    Args:
        file: the URDF; one that ends in .xacro is expanded, which evaluates its expressions; or the
            name of a robot of robot_descriptions; or calibration.conf of a controller of Universal
            Robots (.conf), or what ur_calibration wrote of it (.yaml).
        out: description to write; its stem names the arm.
        base: link that is the arm's base; without it, the root. Joints may carry it, as a camera on
            the head, or the flange with the robot's base as tip.
        tip: link that is the end-effector; without it, the only tip. Without both, those of a known
            robot are found as docs/arms.md has it.
        xacro: arguments of a xacro file, each as NAME:=VALUE.
        robot: the model whose calibration it is: name of an arm, or the file of one (.yaml).

    Examples:
        pa10cal import_arm robot.urdf --out my_arm.yaml
        pa10cal import_arm cell.urdf --base base_link --tip tool0 --out my_arm.yaml
        pa10cal import_arm ur.urdf.xacro --xacro ur_type:=ur5e --tip tool0 --out my_arm.yaml
        pa10cal import_arm ur5e --base base --tip wrist_3_link --out my_arm.yaml
        pa10cal import_arm calibration.conf --robot ur10 --out my_ur10.yaml
    """
    from pa10cal.errors import ArmError
    from pa10cal.files.known_arms import XACRO
    from pa10cal.files.ur_calibration import ENDINGS

    if out.suffix != ".yaml":
        raise ArmError(
            "the description is a YAML file",
            where="--out",
            value=str(out),
            allowed="a name that ends in .yaml",
            remedy="rename it",
        )
    is_calibration = file.suffix.lower() in ENDINGS
    for option, value, needed, of_file in (
        ("--base", base, not is_calibration, "a URDF"),
        ("--tip", tip, not is_calibration, "a URDF"),
        ("--xacro", " ".join(xacro), file.suffix == XACRO, f"a file that ends in {XACRO}"),
        ("--robot", robot, is_calibration, f"a calibration ({', '.join(ENDINGS)})"),
    ):
        if value and not needed:
            raise ArmError(
                f"{file.name} is imported without this option",
                where=option,
                value=value,
                allowed=f"only with {of_file}",
                remedy="remove the option, or give the file that it is meant for",
            )
    if is_calibration:
        _import_ur_calibration(file, out, robot)
    else:
        _import_urdf(file, out, base, tip, _xacro_arguments(xacro))


def _xacro_arguments(stated: tuple[str, ...]) -> dict[str, str]:
    """Return the values of a xacro file's arguments by name.

    Raises:
        ArmError: when one has no value, or is stated twice.
    """
    from pa10cal.errors import ArmError

    arguments: dict[str, str] = {}
    for each in stated:
        name, mark, value = each.partition(":=")
        if not mark or name in arguments:
            raise ArmError(
                "an argument of xacro is stated twice"
                if mark
                else "an argument of xacro has no value",
                where="--xacro",
                value=each,
                allowed="NAME:=VALUE, each name once",
                remedy="correct it",
            )
        arguments[name] = value
    return arguments


def _import_urdf(
    file: Path, out: Path, base: str | None, tip: str | None, arguments: Mapping[str, str]
) -> None:
    """Write the description of the arm in a URDF, or of a known robot, and a copy of the URDF."""
    import numpy as np

    from pa10cal.arm.description import neighbouring_axes
    from pa10cal.arm.urdf_ends import ends_of_arm
    from pa10cal.arm.urdf_import import arm_from_urdf_text
    from pa10cal.files.arms import arm_text, parse_arm, with_short_limits
    from pa10cal.files.known_arms import known_urdf, read_urdf, refuse_unknown
    from pa10cal.files.output import whole_files
    from pa10cal.yaml_file import parse_yaml

    # A file goes before a robot of its name; a name with an ending is that of a file.
    may_be_known = len(file.parts) == 1 and not file.suffix and not file.is_file()
    known = known_urdf(str(file)) if may_be_known else None
    if known is None:
        if may_be_known:
            raise refuse_unknown(str(file))
        text, where, origin = read_urdf(file, arguments), str(file), file.name
    else:
        text, where, origin = known.text, known.where, known.where
        if base is None and tip is None:
            base, tip = ends_of_arm(text, where)
    imported = arm_from_urdf_text(text, out.stem, base=base, tip=tip, where=where)
    arm = with_short_limits(imported.arm)
    lines = [
        f"From {imported.base} to {imported.tip}, joints 1 to {arm.n}: "
        f"{', '.join(imported.joints)}."
    ]
    for axes in neighbouring_axes(arm):
        if axes.parallel:
            lines.append(
                f"Joints {axes.joints[0]} and {axes.joints[1]} are "
                f"{np.degrees(axes.angle_rad):.2g} degrees from parallel: row {axes.row} takes "
                "beta in place of d."
            )
    lines += [f"{note[0].upper()}{note[1:]}." for note in imported.notes]
    copy = out.with_suffix(".urdf")
    source = {"file": copy.name, "base": imported.base, "tip": imported.tip}
    described = arm_text(arm, [f"Imported from {origin}.", *lines], source)
    parse_arm(parse_yaml(described), where=str(out))  # refuse what could not be read again
    _refuse_another_urdf(copy, text, out)
    with whole_files(out, copy) as (description, beside):
        description.write_text(described, encoding="utf-8", newline="\n")
        beside.write_text(text, encoding="utf-8", newline="")
    print(
        "\n".join(lines) + "\n"
        f"{out}: forward kinematics differs from that of the URDF by "
        f"{imported.forward_kinematics_difference_m:.1e} m and "
        f"{imported.forward_kinematics_difference_rad:.1e} rad at most"
    )


def _refuse_another_urdf(copy: Path, text: str, out: Path) -> None:
    """Refuse to replace a URDF other than the one that is copied, or that `out` came from."""
    from contextlib import suppress

    from pa10cal.errors import ArmError

    if not copy.is_file() or copy.read_bytes() == text.encode():
        return
    with suppress(FileNotFoundError, UnicodeDecodeError):
        if f"file: {copy.name}" in out.read_text(encoding="utf-8"):
            return
    raise ArmError(
        "the copy of the URDF would replace another one",
        where="--out",
        value=str(copy),
        allowed="a name of which no .urdf is there, or the description that came from it",
        remedy="give the description another name, or move that file away",
    )


def _import_ur_calibration(file: Path, out: Path, robot: str | None) -> None:
    """Write the description of an arm of Universal Robots as its maker calibrated it."""
    from pa10cal.arm.chain import mean_distance
    from pa10cal.files.arms import arm_asked, arm_text, parse_arm
    from pa10cal.files.output import write_text
    from pa10cal.files.ur_calibration import read_ur_calibration
    from pa10cal.yaml_file import parse_yaml

    calibration = read_ur_calibration(file)
    designed = None if robot is None else arm_asked(robot, file.parent)
    arm = calibration.arm(out.stem, designed)
    lines, stated = ["Its controller computes with these rows while it uses this calibration."], {}
    lines += calibration.notes
    if designed is None:
        lines.append("Limits, gear ratios and masses are not in it: name the model with --robot.")
    else:
        stated["of"] = designed.name
        mean_m, most_m, _ = mean_distance(designed, arm)
        lines.append(
            f"Its flange is {1e3 * mean_m:.2f} mm from that of {designed.name} in the mean of all "
            f"postures, {1e3 * most_m:.2f} mm at most."
        )
    if calibration.hash:
        stated["hash"] = calibration.hash
    comments = [f"Calibration by the maker, from {file.name}.", *lines]
    text = arm_text(arm, comments, maker_calibration=stated)
    parse_arm(parse_yaml(text), where=str(out))  # refuse what could not be read again
    write_text(out, text)
    print("\n".join([*lines, f"{out}: {arm.title}"]))


#: Of more parameters of an effect only the first and the last are listed.
_MOST_NAMES = 4


def effects(*, robot: str = "pa10_6ce") -> None:
    """List the effects that discovery can name at an arm, each with its formula.

    Args:
        robot: name of an arm description, or the file of one (.yaml).

    Examples:
        pa10cal effects
        pa10cal effects --robot iiwa14
    """
    from pa10cal.files.arms import arm_asked
    from pa10cal.terms.effects.vocabulary import vocabulary_of

    arm = arm_asked(robot)
    print("| effect | meaning | sits at | formula | parameters | expected size |")
    print("| --- | --- | --- | --- | --- | --- |")
    for effect_at_places in vocabulary_of(arm):
        effect = effect_at_places[0]
        reported = effect.report(effect.starts[0]).parameters
        positive_count = effect.linear if effect.limits.positive else 0
        parameters = [
            f"{parameter.name}{' > 0' if k < positive_count else ''} [{parameter.unit}]"
            for k, parameter in enumerate(reported)
        ]
        if len(parameters) > _MOST_NAMES:
            parameters[1:-1] = ["…"]
        size = effect.parameters[0]
        cells = (
            f"`{effect.id}`",
            (type(effect).__doc__ or "").splitlines()[0].removesuffix("."),
            # `joint 1, 2, 3` in place of `joint 1, joint 2, joint 3`
            ", ".join(each.of for each in effect_at_places).replace(", joint ", ", "),
            f"`{effect.formula}`",
            ", ".join(parameters),
            f"{size.plausible:.2g} {size.unit}".removesuffix(" 1"),
        )
        print(f"| {' | '.join(cells)} |")

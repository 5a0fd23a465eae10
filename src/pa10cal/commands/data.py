"""Commands for files, arms and data: `columns`, `import`, `fetch`, `import_arm`, `effects`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

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
        robot: name of the arm: of a description beside the file (also as NAME.yaml), of a shipped
            one, or of robot_descriptions.
        name: name of the campaign; without it, that of the folder.
        arms: folder of arm descriptions; without it, `arms` beside the folder of the files.

    Examples:
        pa10cal columns examples/ur10-pose/tracker.txt --robot ur10
        pa10cal columns measured/export.csv --robot ur10 > measured/campaign.yaml
        pa10cal columns measured/controller.csv measured/tracker.csv --robot ur10
    """
    import sys

    import yaml

    from pa10cal.campaign.file_roles import follows_contract, label_of
    from pa10cal.campaign.propose import propose, propose_two_logs
    from pa10cal.campaign.sniffing import sniff
    from pa10cal.errors import SettingsError, one_line, visible
    from pa10cal.files.arms import joint_names, load_arm

    if len(files) > 2 or len({file.absolute().parent for file in files}) > 1:
        raise SettingsError(
            "too many files" if len(files) > 2 else "the two logs are not in one folder",
            where="columns",
            value=", ".join(map(str, files)),
            allowed="one file, or the joints' log and the readings' log in one folder",
            remedy="give one or two files of the campaign's folder",
        )
    file = files[0]
    robot = None if robot is None else robot.removesuffix(".yaml")
    arm = None if robot is None else load_arm(robot, file.parent, arms)
    called = () if robot is None else joint_names(robot, file.parent, arms)
    label = name or label_of(file.absolute().parent)
    if len(files) == 2:
        logs = sniff(files[0]), sniff(files[1])
        paths = files[0], files[1]
        proposal = propose_two_logs(logs, paths, label, robot or "my_arm", arm, called)
    else:
        found = sniff(file)
        proposal = propose(found, file.name, label, robot or "my_arm", arm, called)
        if follows_contract(found):
            del proposal.content["columns"]

    def proposed(*, as_it_is: bool) -> str:
        text: str = yaml.safe_dump(
            proposal.content,
            sort_keys=False,
            default_flow_style=None,
            width=90,
            allow_unicode=as_it_is,
        )
        return text

    text = proposed(as_it_is=True)
    if text != visible(text):  # escaped, so that what is printed is read as it was meant
        text = proposed(as_it_is=False)
    told = (
        [] if arm is None else [*(f"# {each}" for each in arm.remarks), *_tried(files, text, arm)]
    )
    read_as = (f"# {line}" for line in proposal.read_as)
    known = (f"# {line}" for line in proposal.known)
    comments = (*known, *told, *read_as, *(f"# check {each}" for each in proposal.checks))
    print("\n".join(map(one_line, comments)))
    print(text, end="")
    if sys.stdout.isatty():
        print(f"\nSave this as {file.parent / 'campaign.yaml'}, correct it, and then:")
        print(f"  pa10cal run {file.parent}")


def _tried(files: tuple[Path, ...], text: str, arm: Arm) -> list[str]:
    """Read a campaign as it is proposed, and return what its reader is to know of that."""
    from collections import Counter
    from shutil import copyfile
    from tempfile import TemporaryDirectory

    from pa10cal.campaign.description import DESCRIPTION_FILE
    from pa10cal.campaign.read import read_campaign
    from pa10cal.campaign.text_lines import names_beside
    from pa10cal.errors import Pa10calError
    from pa10cal.files.arms import arm_text

    with TemporaryDirectory() as folder:
        beside = Path(folder)
        (beside / DESCRIPTION_FILE).write_text(text, encoding="utf-8")
        (beside / f"{arm.name}.yaml").write_text(arm_text(arm), encoding="utf-8")
        for file in files:
            copyfile(file, beside / file.name)  # no link: those out of a folder are not followed
            if (stated := names_beside(file)) is not None:
                copyfile(stated, beside / stated.name)
        try:
            found = read_campaign(beside)
        except Pa10calError as error:
            return [f"# check all of it: it is refused: {error}".replace(f"{folder}/", "")]
        rows = f"{len(found.observations)} rows can be used, {len(found.quarantined)} cannot"
        lost = Counter(row.reason for row in found.quarantined).most_common()
        cannot = [
            f"# cannot be used: {times} {'row' if times == 1 else 'rows'}: {reason}"
            for reason, times in lost
        ]
        said = (" joined by ", " by whole turns")
        joined = [f"# {note}" for note in found.notes if any(word in note for word in said)]
        warned = (f"# check: {each}" for each in found.warnings)
        return [f"# read so: {rows}", *cannot, *joined, *warned]


#: Rows left out that are shown one by one; all of them are in the campaign's left_out.csv.
SHOWN = 10


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
    campaigns = tuple(each for each in campaigns if not only or each.name in only)
    places = write_campaigns(campaigns, out)
    for campaign, place in zip(campaigns, places, strict=True):
        readings = campaign.readings
        told = (
            f"{readings.path.name}, read as it is"
            if isinstance(readings, AsItIs)
            else f"{len(campaign.left_out)} rows left out"
        )
        parts = [told, *campaign.notes]
        print(f"{place}: {'; '.join(parts)}")
        for row in campaign.left_out[:SHOWN]:
            print(f"  left out: {row.file}:{row.line}: {row.reason} {row.value}".rstrip())
        if len(campaign.left_out) > SHOWN:
            print(f"  … and {len(campaign.left_out) - SHOWN} more in {place / 'left_out.csv'}")


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

    asked = dataset_named(dataset)
    print(asked.published.terms, flush=True)
    fetched = fetch_files(asked, out, source or None)
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
        base: link that is the arm's base; without it, the root.
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
    import numpy as np

    from pa10cal.arm.description import neighbouring_axes
    from pa10cal.errors import ArmError
    from pa10cal.files.arms import arm_text, parse_arm, with_short_limits
    from pa10cal.files.known_arms import known_urdf, read_urdf
    from pa10cal.files.output import whole_files
    from pa10cal.files.ur_calibration import ENDINGS
    from pa10cal.yaml_file import parse_yaml

    if out.suffix != ".yaml":
        raise ArmError(
            "the description is a YAML file",
            where="--out",
            value=str(out),
            allowed="a name that ends in .yaml",
            remedy="rename it",
        )
    if file.suffix in ENDINGS:
        _import_ur(file, out, robot)
        return
    arguments = dict(each.partition(":=")[::2] for each in xacro if ":=" in each)
    if len(arguments) < len(xacro):
        raise ArmError(
            "an argument of xacro has no value, or is stated twice",
            where="--xacro",
            value=" ".join(xacro),
            allowed="NAME:=VALUE, each name once",
            remedy="correct it",
        )
    from pa10cal.arm.imported import arm_from_urdf_text  # late: a calibration needs no pinocchio
    from pa10cal.arm.urdf_chain import ends_of_arm

    known = None if file.suffix or file.exists() else known_urdf(str(file))
    text = read_urdf(file, arguments) if known is None else known.text
    where = str(file) if known is None else known.where
    if known is not None and base is None and tip is None:
        base, tip = ends_of_arm(text, where)
    imported = arm_from_urdf_text(text, out.stem, base=base, tip=tip, where=where)
    arm = with_short_limits(imported.arm)
    parallel = [axes for axes in neighbouring_axes(arm) if axes.parallel]
    lines = [
        f"From {imported.base} to {imported.tip}, joints 1 to {arm.n}: "
        f"{', '.join(imported.joints)}.",
        *(
            f"Joints {axes.joints[0]} and {axes.joints[1]} are {np.degrees(axes.angle_rad):.2g} "
            f"degrees from parallel: row {axes.row} takes beta in place of d."
            for axes in parallel
        ),
        *(f"{note[0].upper()}{note[1:]}." for note in imported.notes),
    ]
    copy = out.with_suffix(".urdf")
    source = {"file": copy.name, "base": imported.base, "tip": imported.tip}
    of_file = file.name if known is None else known.where
    described = arm_text(arm, [f"Imported from {of_file}.", *lines], source)
    parse_arm(parse_yaml(described), where=str(out))  # what would not be read is not written
    with whole_files(out, copy) as (description, beside):
        description.write_text(described, encoding="utf-8", newline="\n")
        beside.write_text(text, encoding="utf-8", newline="")
    print(
        "\n".join(lines) + "\n"
        f"{out}: forward kinematics differs from that of the URDF by "
        f"{imported.forward_kinematics_difference_m:.1e} m and "
        f"{imported.forward_kinematics_difference_rad:.1e} rad at most"
    )


def _import_ur(file: Path, out: Path, robot: str | None) -> None:
    """Write the description of an arm of Universal Robots as its maker calibrated it."""
    from pa10cal.arm.chain import mean_distance
    from pa10cal.files.arms import arm_asked, arm_text, parse_arm
    from pa10cal.files.output import write_text
    from pa10cal.files.ur_calibration import read_ur_calibration
    from pa10cal.yaml_file import parse_yaml

    calibration = read_ur_calibration(file)
    designed = None if robot is None else arm_asked(robot, file.parent)
    arm = calibration.arm(out.stem, designed)
    told = ["Its controller computes with these rows while it uses this calibration."]
    if designed is None:
        told.append("Limits, gear ratios and masses are not in it: name the model with --robot.")
    else:
        mean_m, most_m, _ = mean_distance(designed, arm)
        told.append(
            f"Its flange is {1e3 * mean_m:.2f} mm from that of {designed.name} in the mean of all "
            f"postures, {1e3 * most_m:.2f} mm at most."
        )
    of = {} if designed is None else {"of": designed.name}
    stated = of | ({"hash": calibration.hash} if calibration.hash else {})
    comments = [f"Calibration by the maker, from {file.name}.", *told]
    text = arm_text(arm, comments, maker_calibration=stated)
    parse_arm(parse_yaml(text), where=str(out))
    write_text(out, text)
    print("\n".join([*told, f"{out}: {arm.title}"]))


#: Of more parameters only the first and the last are listed.
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
    from pa10cal.terms.effects.effect import vocabulary_of

    arm = arm_asked(robot)
    print("| effect | meaning | sits at | formula | parameters | expected size |")
    print("| --- | --- | --- | --- | --- | --- |")
    for places in vocabulary_of(arm):
        first = places[0]
        reported = first.report(first.starts[0]).parameters
        signed = first.linear if first.positive else 0
        shown = [
            f"{each.name}{' > 0' if k < signed else ''} [{each.unit}]"
            for k, each in enumerate(reported)
        ]
        if len(shown) > _MOST_NAMES:
            shown[1:-1] = ["…"]
        size = first.parameters[0]
        cells = (
            f"`{first.id}`",
            (type(first).__doc__ or "").splitlines()[0].removesuffix("."),
            ", ".join(each.of for each in places).replace(", joint ", ", "),
            f"`{first.formula}`",
            ", ".join(shown),
            f"{size.plausible:.2g} {size.unit}".removesuffix(" 1"),
        )
        print(f"| {' | '.join(cells)} |")

"""The table of measured robots: read from results, written as CSV and for docs/measured.md.

`python -m pa10cal.datasets.measured [RECORD] [PAGE]`, from the root of the repository, puts the
table of RECORD (results/measured/measured.json) into PAGE (docs/measured.md).
"""

from __future__ import annotations

import re
import sys
from argparse import ArgumentParser
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from pa10cal.campaign.description import read_description
from pa10cal.datasets.known_campaigns import CAMPAIGNS, groups_of
from pa10cal.errors import Pa10calError, RecordError
from pa10cal.files.arms import load_arm
from pa10cal.files.output import write_text
from pa10cal.files.table_cells import csv_text, markdown_cell
from pa10cal.results import outcomes
from pa10cal.results.calibration import CalibrationRecord
from pa10cal.results.codec import read
from pa10cal.results.discovery import VerdictRecord
from pa10cal.results.evaluation import HeldOutModel, HoldoutRecord, TransferRecord

#: Models of the table, each with all that those before it have.
MODELS: tuple[outcomes.MeasuredModel, ...] = ("nominal", "geometry", "springs", "effects")
RECORD, PAGE = Path("results/measured/measured.json"), Path("docs/measured.md")
BEGIN = "<!-- From here to the next mark generated: python -m pa10cal.datasets.measured -->"
END = "<!-- End of what is generated. -->"


@dataclass(frozen=True)
class MeasuredResults:
    """Results of measured campaigns, from which the table is read."""

    results: Path  # holds a folder of results for each campaign and group
    calibration: str  # load case that was evaluated
    # by source and target the errors of a model that was carried over (file of a
    # `TransferRecord`), or why it was not
    carried: Mapping[tuple[str, str], Path | str]

    def record(self, raw: Mapping[str, Path]) -> outcomes.MeasuredRobotsRecord:
        """Return the table of campaigns, whose folders of raw files are `raw`, and their groups.

        Raises:
            RecordError: when a campaign has no `chain.json`.
        """
        rows = [self._robot(name, folder) for name, folder in raw.items()]
        for name, members in groups_of(raw).items():
            if not (self.results / name / outcomes.ChainRecord.FILE).is_file():
                continue
            row = replace(self, carried={})._robot(name, raw[members[0]])
            instruments = dict.fromkeys(CAMPAIGNS[member].instrument for member in members)
            together = {"members": members, "instrument": "; ".join(instruments), "published": None}
            last = max(k for k, each in enumerate(rows) if each.campaign in members)
            rows.insert(last + 1, row.model_copy(update=together))
        return outcomes.MeasuredRobotsRecord(robots=tuple(rows))

    def _robot(self, name: str, raw: Path) -> outcomes.MeasuredRobot:
        """Return the row of a campaign; what its stages did not come to is not in it."""
        folder, known = self.results / name, CAMPAIGNS.get(name)
        outcome = read(outcomes.ChainRecord, folder / outcomes.ChainRecord.FILE, within=folder)
        robot, kind = None, None
        with suppress(Pa10calError):  # where they can be read
            campaign = read_description(raw)
            robot, kind = load_arm(campaign.robot, raw).title, campaign.instrument.kind
        common = {
            "campaign": name,
            "robot": robot,
            "instrument": known.instrument if known else kind,
            "status": outcome.status,
            "published": (known.published or None) if known else None,
        }
        if outcome.status != "done":
            message = f"{outcome.stage}: {outcome.message}"
            return outcomes.MeasuredRobot(
                **common,
                message=_without_folders(message, raw, self.results),
                names=(),
                faults=(),
                errors={},
                carried=(),
            )
        fitted = read(CalibrationRecord, self._calibration_of(name), within=folder)
        verdict = read(VerdictRecord, folder / "discovery/verdict.json", within=folder)
        held_out = read(HoldoutRecord, folder / HoldoutRecord.FILE, within=folder)
        calibrated = sum(each.after.configurations for each in fitted.errors.values())
        return outcomes.MeasuredRobot(
            **common,
            poses=calibrated + held_out.configurations,
            held_out=held_out.configurations,
            grade=fitted.health.grade,
            verdict=verdict.verdict,
            names=tuple(effect.either for effect in verdict.effects),
            faults=tuple(f"{fault.kind}, {fault.where}" for fault in verdict.faults or ()),
            errors=errors_by_model(held_out.models, springs=fitted.has_springs),
            carried=tuple(self.models_carried_to(name, raw)),
        )

    def _calibration_of(self, name: str) -> Path:
        """Return the file of a campaign's calibration."""
        return self.results / name / f"calibration/{self.calibration}.json"

    def models_carried_to(self, name: str, raw: Path) -> Iterator[outcomes.Carried]:
        """Yield the models of other campaigns in this one, whose raw files are in `raw`."""
        for (source, target), found in self.carried.items():
            if target != name:
                continue
            if isinstance(found, str):
                message = _without_folders(found, raw, self.results)
                yield outcomes.Carried(source=source, message=message, errors={})
                continue
            fitted = read(
                CalibrationRecord, self._calibration_of(source), within=self.results / source
            )
            models = read(TransferRecord, found).models
            errors = errors_by_model(models, springs=fitted.has_springs)
            yield outcomes.Carried(source=source, errors=errors)


def _without_folders(message: str, *folders: Path) -> str:
    """Return a message with the files of some folders named from there: a page is of no machine."""
    paths = {str(path): folder.name for folder in folders for path in (folder, folder.resolve())}
    for path in sorted(paths, key=len, reverse=True):
        whole_path = rf"(?<![\w./-]){re.escape(path)}"
        message = re.sub(rf"{whole_path}/", "", message)
        message = re.sub(rf"{whole_path}(?![\w-]|\.\w)", paths[path] or path, message)
    return message


def errors_by_model(
    models: Mapping[str, HeldOutModel], *, springs: bool
) -> dict[outcomes.MeasuredModel, outcomes.HeldOutError]:
    """Return errors by the models of the table; without springs `linear` is the geometry alone.

    Of rows along a path those at unseen stretches.
    """
    named = {
        "nominal": "uncalibrated",
        "geometry": "geometry" if springs or "geometry" in models else "linear",
        "springs": "linear" if springs else "",
        "effects": "extended",
    }
    first = {name: next(iter(model.by_place.values())) for name, model in models.items()}
    return {
        model: outcomes.HeldOutError(
            mean_mm=first[named[model]].mean_mm, rms_mm=first[named[model]].rms_mm
        )
        for model in MODELS
        if named[model] in first
    }


def robots_csv(record: outcomes.MeasuredRobotsRecord) -> str:
    """Return the table as CSV, a row a campaign and a row a model carried to it."""
    kinds = [(model, kind) for model in MODELS for kind in ("mean_mm", "rms_mm")]

    def numbers(errors: Mapping[outcomes.MeasuredModel, outcomes.HeldOutError]) -> list[str | None]:
        return [f"{getattr(errors[m], kind):.4f}" if m in errors else None for m, kind in kinds]

    header = (
        *("campaign", "model_of", "robot", "instrument", "poses", "held_out"),
        *(f"{model}_{kind}" for model, kind in kinds),
        *("grade", "verdict", "names", "faults", "status", "message", "published"),
    )
    lines: list[tuple[object, ...]] = []
    for robot in record.robots:
        about = (robot.robot, robot.instrument, robot.poses, robot.held_out)
        verdict = (robot.grade, robot.verdict, "; ".join(robot.names), "; ".join(robot.faults))
        cells = (robot.campaign, robot.campaign, *about, *numbers(robot.errors), *verdict)
        lines.append((*cells, robot.status, robot.message, robot.published))
        for other in robot.carried:
            status = "done" if other.message is None else "refused"
            cells = (robot.campaign, other.source, *about, *numbers(other.errors))
            lines.append((*cells, None, None, None, None, status, other.message, None))
    return csv_text(header, lines)


def markdown(record: outcomes.MeasuredRobotsRecord) -> str:
    """Return the tables of the page."""

    def line(cells: Sequence[str]) -> str:
        return f"| {' | '.join(cells)} |"

    def header(*titles: str) -> list[str]:
        return [line(titles), line(["---"] * len(titles))]

    def errors(of: Mapping[outcomes.MeasuredModel, outcomes.HeldOutError]) -> list[str]:
        pairs = [of.get(model) for model in MODELS]
        return [f"{pair.mean_mm:.3f} / {pair.rms_mm:.3f}" if pair else "" for pair in pairs]

    head = ("campaign", "robot, instrument", "poses", *MODELS)
    lines = header(*head, "verdict, names", "reported by others")
    for robot in record.robots:
        faults = [f"the log: {fault}" for fault in robot.faults]
        said = map(markdown_cell, (*robot.names, *faults))
        verdict = "; ".join([f"`{robot.verdict}`", *said])
        verdict = markdown_cell(f"{robot.status}: {robot.message}") if robot.message else verdict
        about = ", ".join(text for text in (robot.robot, robot.instrument) if text)
        if robot.members:
            about += f"; {', '.join(robot.members)} as one"
        poses = "" if robot.poses is None else f"{robot.poses} ({robot.held_out})"
        of = (f"`{robot.campaign}`", markdown_cell(about), poses, *errors(robot.errors))
        lines.append(line([*of, verdict, markdown_cell(robot.published or "")]))
    carried = [(robot.campaign, other) for robot in record.robots for other in robot.carried]
    if carried:
        lines += ["", "Carried to another campaign, base and tool alone fitted there:", ""]
        lines += header("model of", "in", *MODELS)
    for name, other in carried:
        cells = (
            [markdown_cell(other.message), "", "", ""] if other.message else errors(other.errors)
        )
        lines.append(line([f"`{other.source}`", f"`{name}`", *cells]))
    return "\n".join(lines) + "\n"


def page_text(now: str, record: outcomes.MeasuredRobotsRecord) -> str:
    """Return the page with its generated part renewed.

    Raises:
        RecordError: when the page lacks the marks of that part.
    """
    part = re.compile(f"{re.escape(BEGIN)}.*?{re.escape(END)}", re.DOTALL)
    text, count = part.subn(lambda _: f"{BEGIN}\n\n{markdown(record)}\n{END}", now)
    if not count:
        raise RecordError(
            "the page has no place for the table",
            where="page",
            allowed=f"a page with the lines {BEGIN} and {END}",
            remedy="put both lines where the table is to stand",
        )
    return text


def main(words: Sequence[str]) -> None:
    """Put the table of a record into the page."""
    parser = ArgumentParser(prog="python -m pa10cal.datasets.measured", description=main.__doc__)
    parser.add_argument("record", nargs="?", type=Path, default=RECORD, help=f"default: {RECORD}")
    parser.add_argument("page", nargs="?", type=Path, default=PAGE, help=f"default: {PAGE}")
    given = parser.parse_args(words)
    try:
        record = read(outcomes.MeasuredRobotsRecord, given.record)
        text = page_text(given.page.read_text(encoding="utf-8"), record)
    except (OSError, Pa10calError) as error:
        parser.error(str(error))
    write_text(given.page, text)


if __name__ == "__main__":
    main(sys.argv[1:])

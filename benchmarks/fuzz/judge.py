"""What becomes of a mutated campaign or of mutated settings."""

from __future__ import annotations

import signal
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

import numpy as np

from benchmarks.fuzz.corpus import Original
from benchmarks.fuzz.mutations import Files
from pa10cal.campaign.read import read_campaign
from pa10cal.errors import Pa10calError
from pa10cal.interface import calibrate
from pa10cal.settings import parse_settings
from pa10cal.yaml_file import parse_yaml

HANGS_S = 60
#: A model graded good is wrong where it is further off than so many standard uncertainties.
_WRONG = 4.0


class _Hangs(BaseException):
    """A judgement took longer than it may; nothing catches it on its way."""


@dataclass(frozen=True)
class Outcome:
    """What became of one mutation.

    Attributes:
        word: `refused`, a grade, `read` of settings; or `fault`, `hang`, `wrong`.
        why: message, or traceback of a fault.
        seconds: time of the processor.
    """

    word: str
    why: str
    seconds: float

    @property
    def bad(self) -> bool:
        """Whether it must not be."""
        return self.word in ("fault", "hang", "wrong")


def judged_campaign(files: Files, original: Original) -> Outcome:
    """Read and calibrate a campaign of these files."""

    def come_to() -> tuple[str, str]:
        with tempfile.TemporaryDirectory() as folder:
            for name, content in files.items():
                Path(folder, name).write_bytes(content)
            campaign = read_campaign(Path(folder))
        model = calibrate(campaign)
        if model.grade != "good" or model.arm.n != original.q_rad.shape[1]:
            return model.grade, ""
        predicted = model.predict(original.q_rad, frame="tool")
        u_mm = np.hypot(original.u_mm, np.sqrt(np.mean(predicted.u_mm**2)))
        off_mm = original.off_mm(predicted.T[:, :3, 3])
        if off_mm > _WRONG * u_mm:
            return "wrong", f"graded good, {off_mm:.4f} mm off, u {u_mm:.4f} mm"
        return model.grade, ""

    return outcome_of(come_to)


def judged_settings(text: bytes) -> Outcome:
    """Read a config.yaml."""

    def come_to() -> tuple[str, str]:
        try:
            content = parse_yaml(text.decode("utf-8-sig"))
        except ValueError as error:  # as Snakemake says it, which reads the file
            return "refused", str(error)
        parse_settings(content, where="config.yaml")
        return "read", ""

    return outcome_of(come_to)


def outcome_of(come_to: object) -> Outcome:
    """Return what something comes to: its word, a refusal, a hang or a fault."""
    began = time.process_time()
    try:
        with _limited(HANGS_S), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            word, why = come_to()  # type: ignore[operator]
    except Pa10calError as error:
        word, why = "refused", str(error)
    except _Hangs:
        word, why = "hang", f"more than {HANGS_S} s"
    except Exception:
        word, why = "fault", traceback.format_exc(limit=-6)
    return Outcome(word, why, time.process_time() - began)


@contextmanager
def _limited(seconds: int) -> Iterator[None]:
    """Raise `_Hangs` where the block takes longer on the processor."""

    def late(_: int, __: FrameType | None) -> None:
        raise _Hangs

    before = signal.signal(signal.SIGVTALRM, late)
    signal.setitimer(signal.ITIMER_VIRTUAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        signal.signal(signal.SIGVTALRM, before)

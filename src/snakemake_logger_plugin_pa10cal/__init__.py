"""Tells `pa10cal run` and `pa10cal reproduce` which jobs of the workflow start, end and fail.

Snakemake finds a logger by the name of its module. One JSON object a line goes to the pipe whose
file descriptor PA10CAL_EVENTS names, which ends with the process; without it, none is written.
"""

from __future__ import annotations

import json
import os
from logging import LogRecord
from typing import Any

from snakemake_interface_logger_plugins.base import LogHandlerBase

#: Events that are passed on, and which of their attributes: `jobid` and `job_id` as Snakemake has
#: them.
_PASSED = {
    "job_info": ("jobid", "rule_name", "wildcards"),
    "job_finished": ("job_id",),
    "job_error": ("jobid", "rule_name", "log"),
    "progress": ("done", "total"),
}


class LogHandler(LogHandlerBase):
    """Writes what happens to jobs; all else is left to Snakemake."""

    def __post_init__(self) -> None:
        pipe = os.environ.get("PA10CAL_EVENTS")  # not set where Snakemake was called by hand
        self._pipe = None if pipe is None else int(pipe)

    def emit(self, record: LogRecord) -> None:
        """Write one event."""
        event = str(getattr(record, "event", ""))
        if self._pipe is None or event not in _PASSED:
            return
        told: dict[str, Any] = {"event": event}
        told |= {name: getattr(record, name, None) for name in _PASSED[event]}
        try:
            os.write(self._pipe, f"{json.dumps(told, default=str)}\n".encode())
        except OSError:  # whoever reads has ended
            self.handleError(record)

    @property
    def writes_to_stream(self) -> bool:
        """Whether it writes to standard output or error, in place of Snakemake."""
        return False

    @property
    def writes_to_file(self) -> bool:
        """Whether it writes to a file of Snakemake's."""
        return False

    @property
    def has_filter(self) -> bool:
        """Whether it chooses itself what it takes."""
        return True

    @property
    def has_formatter(self) -> bool:
        """Whether it formats itself what it takes."""
        return True

    @property
    def needs_rulegraph(self) -> bool:
        """Whether it is told the graph of rules."""
        return False

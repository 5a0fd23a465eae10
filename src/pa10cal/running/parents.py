"""Jobs end with the run that started them, however that ended."""

from __future__ import annotations

import os
import select
import signal
import threading
import time
from contextlib import suppress

#: Environment: processes with which this one ends, by their numbers.
PARENTS = "PA10CAL_PARENTS"
#: How often a machine without pidfd is looked at for them [s].
_PERIOD_S = 0.2


def end_with_parents() -> None:
    """Kill this process as soon as one of those that `PARENTS` names has ended.

    A job hangs below a shell, which lives on when Snakemake is killed: a signal at a parent's death
    would not reach the job. What it leaves half-written is removed by the next run.
    """
    parents = [int(word) for word in os.environ.pop(PARENTS, "").split()]
    if parents:
        threading.Thread(target=_watch, args=(parents,), daemon=True).start()


def _watch(parents: list[int]) -> None:
    with suppress(ProcessLookupError):  # one had ended already
        _wait(parents)
    os.kill(os.getpid(), signal.SIGKILL)


def _wait(parents: list[int]) -> None:
    """Return when one of these processes has ended.

    Raises:
        ProcessLookupError: when one is not there.
    """
    ended = select.poll()
    try:
        for parent in parents:
            ended.register(os.pidfd_open(parent), select.POLLIN)
    except ProcessLookupError:
        raise
    except (AttributeError, OSError):  # a system without it
        while True:
            for parent in parents:
                os.kill(parent, 0)
            time.sleep(_PERIOD_S)
    ended.poll()

"""Part of a command in a child process."""

from __future__ import annotations

import os

import pytest

from pa10cal.running.child import in_child


@pytest.mark.parametrize("interrupts", [1, 2])
def test_an_interrupt_is_one_though_the_child_has_just_ended(monkeypatch, interrupts):
    """Then there is no process any more that could be interrupted, or killed."""
    wait, waits = os.waitpid, []

    def interrupted(child, options):
        waits.append(child)
        if len(waits) == interrupts:
            wait(child, options)
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "waitpid", interrupted)
    with pytest.raises(KeyboardInterrupt):
        in_child(lambda send: None)
    assert len(waits) == interrupts
    with pytest.raises(ChildProcessError):
        wait(waits[0], 0)

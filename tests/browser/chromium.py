"""Debian's Chromium without a window, driven over the pipe of its DevTools protocol.

Messages are JSON, each ended by a zero byte: commands go to the browser's file descriptor 3,
answers and events come from its 4 (`--remote-debugging-pipe`).
"""

from __future__ import annotations

import base64
import fcntl
import json
import os
import select
import shutil
import signal
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--headless",
    "--no-sandbox",  # the tests may run as root in a container
    "--hide-scrollbars",
    "--use-angle=swiftshader",  # WebGL without a graphics card
    "--enable-unsafe-swiftshader",
    "--remote-debugging-pipe",
)
#: Longest time that a page may take to answer [s]; a machine at work is slow.
PATIENCE_S = 60.0


def installed() -> str:
    """Return the path of the browser.

    Raises:
        FileNotFoundError: when there is none.
    """
    for name in NAMES:
        if found := shutil.which(name):
            return found
    raise FileNotFoundError(
        "these tests need Chromium: apt-get install chromium; make test runs all others without it"
    )


class Browser:
    """A browser in a process of its own; `close` ends it."""

    def __init__(self, profile: Path) -> None:
        commands, self._out = (_high(end) for end in os.pipe())
        self._in, answers = (_high(end) for end in os.pipe())
        words = [installed(), *FLAGS, f"--user-data-dir={profile}"]
        log = (profile.parent / "chromium.log").as_posix()
        self._process = os.posix_spawn(
            words[0],
            words,
            os.environ,
            file_actions=[
                (os.POSIX_SPAWN_DUP2, commands, 3),
                (os.POSIX_SPAWN_DUP2, answers, 4),
                (os.POSIX_SPAWN_OPEN, 2, log, os.O_WRONLY | os.O_CREAT, 0o644),
            ],
            setsid=True,
        )
        os.close(commands)
        os.close(answers)
        self._rest, self._last = b"", 0
        self.events: list[dict[str, Any]] = []

    def close(self) -> None:
        """End the browser and all that it started."""
        with suppress(ProcessLookupError):
            os.killpg(self._process, signal.SIGKILL)
        os.waitpid(self._process, 0)
        os.close(self._out)
        os.close(self._in)

    def send(self, method: str, session: str | None = None, **given: Any) -> dict[str, Any]:
        """Send a command and return its answer; events that come meanwhile are kept."""
        self._last += 1
        message = {"id": self._last, "method": method, "params": given}
        if session is not None:
            message["sessionId"] = session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        until = time.monotonic() + PATIENCE_S
        while True:
            for answer in self._read(until, method):
                if answer.get("id") == self._last:
                    assert "error" not in answer, f"{method}: {answer.get('error')}"
                    return dict(answer["result"])
                self.events.append(answer)

    def wait_for(self, event: str, session: str) -> None:
        """Wait until an event has come."""
        until = time.monotonic() + PATIENCE_S
        while not any(e.get("method") == event and e["sessionId"] == session for e in self.events):
            self.events += self._read(until, event)

    def open(self, page: Path, width: int, height: int, *, dark: bool = False) -> Tab:
        """Open a page in a tab of its own."""
        target = self.send("Target.createTarget", url="about:blank")["targetId"]
        attached = self.send("Target.attachToTarget", targetId=target, flatten=True)
        return Tab(self, attached["sessionId"], page, (width, height), dark)

    def _read(self, until: float, what: str) -> list[dict[str, Any]]:
        ready, _, _ = select.select([self._in], [], [], max(until - time.monotonic(), 0.0))
        assert ready, f"no answer to {what} within {PATIENCE_S:g} s"
        content = os.read(self._in, 1 << 20)
        assert content, "the browser has ended"
        *messages, self._rest = (self._rest + content).split(b"\0")
        return [json.loads(message) for message in messages]


class Tab:
    """A page that has loaded.

    Attributes:
        seconds: processor time of the page until it was there and drawn.
    """

    def __init__(
        self, browser: Browser, session: str, page: Path, size: tuple[int, int], dark: bool
    ) -> None:
        self._browser, self._session = browser, session
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.send(f"{domain}.enable")
        width, height = size
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
        self.send("Emulation.setDeviceMetricsOverride", **metrics)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.send("Emulation.setEmulatedMedia", features=[scheme])
        self.send("Performance.enable", timeDomain="threadTicks")
        self.send("Page.navigate", url=page.absolute().as_uri())
        browser.wait_for("Page.loadEventFired", session)
        # Figures are drawn once their library is unpacked, which the page's `drawn` promises.
        self.evaluate("drawn.then(() => 0)")
        self.evaluate("new Promise(done => requestAnimationFrame(() => setTimeout(done, 0)))")
        metrics = self.send("Performance.getMetrics")["metrics"]
        self.seconds = next(each["value"] for each in metrics if each["name"] == "TaskDuration")

    def send(self, method: str, **given: Any) -> dict[str, Any]:
        """Send a command to the page."""
        return self._browser.send(method, self._session, **given)

    def evaluate(self, expression: str) -> Any:
        """Return the value of an expression in the page, of a promise when it is there."""
        options = {"returnByValue": True, "awaitPromise": True}
        found = self.send("Runtime.evaluate", expression=expression, **options)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    @property
    def complaints(self) -> list[str]:
        """Return errors on the console and exceptions; advice on speed is none."""
        found = []
        for event in self._of_page():
            given = event["params"]
            if event["method"] == "Runtime.exceptionThrown":
                found.append(str(given["exceptionDetails"]))
            elif event["method"] == "Runtime.consoleAPICalled":
                found += [str(given["args"])] * (given["type"] in ("error", "assert"))
            elif event["method"] == "Log.entryAdded":
                found += [given["entry"]["text"]] * (given["entry"]["level"] == "error")
        return found

    @property
    def fetched(self) -> list[str]:
        """Return the addresses that the page asked for, those inside it left out."""
        asked = [e for e in self._of_page() if e["method"] == "Network.requestWillBeSent"]
        urls = [event["params"]["request"]["url"] for event in asked]
        return [url for url in urls if not url.startswith(("data:", "blob:"))]

    def screenshot(self, path: Path, *, whole: bool = False) -> None:
        """Write a picture of what is in view, or of the whole page."""
        found = self.send("Page.captureScreenshot", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(found["data"]))

    def pdf(self, path: Path) -> None:
        """Print the page."""
        found = self.send("Page.printToPDF", paperWidth=8.27, paperHeight=11.69)
        path.write_bytes(base64.b64decode(found["data"]))

    def _of_page(self) -> list[dict[str, Any]]:
        return [e for e in self._browser.events if e.get("sessionId") == self._session]


def _high(descriptor: int) -> int:
    """Return a descriptor above those that the browser gets, closed in other programs."""
    moved = fcntl.fcntl(descriptor, fcntl.F_DUPFD_CLOEXEC, 10)
    os.close(descriptor)
    return moved

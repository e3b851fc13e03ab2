"""Headless Chromium over the pipe of its debugging protocol, for tests of pages."""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome", "headless_shell")
PATIENCE = 120.0
"""Seconds that an answer may take on a loaded machine."""


def found() -> str | None:
    """Return the path of a browser, if there is one."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


class Page:
    """One page of a browser."""

    def __init__(self, send: int, receive: int) -> None:
        self._send, self._receive, self._buffer = send, receive, b""
        self._number, self._session, self.said = 0, "", list[dict[str, Any]]()

    def begin(self) -> None:
        """Open a page and listen to its console."""
        target = self.ask("Target.createTarget", url="about:blank")["targetId"]
        got = self.ask("Target.attachToTarget", targetId=target, flatten=True)
        self._session = got["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self.ask(f"{domain}.enable")

    def ask(self, method: str, **params: Any) -> dict[str, Any]:
        """Send a command and return its answer."""
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._send, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return answer["result"]

    def _next(self) -> dict[str, Any]:
        end = time.monotonic() + PATIENCE
        while b"\0" not in self._buffer:
            if not select.select([self._receive], [], [], max(end - time.monotonic(), 0.0))[0]:
                raise TimeoutError("the browser does not answer")
            part = os.read(self._receive, 1 << 16)
            if not part:
                raise RuntimeError("the browser ended")
            self._buffer += part
        line, _, self._buffer = self._buffer.partition(b"\0")
        message = json.loads(line)
        if "method" in message:
            self.said.append(message)
        return message

    def show(self, path: Path, width: int, dark: bool = False, height: int = 900) -> None:
        """Load a file at a width, and wait until it is there."""
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.ask("Emulation.setEmulatedMedia", features=[scheme])
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.ask("Emulation.setDeviceMetricsOverride", **size)
        self.ask("Page.navigate", url=path.resolve().as_uri())
        end = time.monotonic() + PATIENCE
        while self.value("document.readyState") != "complete" or not self.value(
            f"location.href.endsWith({json.dumps(path.name)})"
        ):
            if time.monotonic() > end:
                raise TimeoutError("the page does not load")
            time.sleep(0.02)

    def value(self, expression: str) -> Any:
        """Return what an expression is in the page."""
        got = self.ask(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        if "exceptionDetails" in got:
            raise RuntimeError(json.dumps(got["exceptionDetails"])[:500])
        return got["result"].get("value")

    @property
    def errors(self) -> list[str]:
        """What the console complained of so far."""
        bad = []
        for message in self.said:
            method, params = message["method"], message["params"]
            if method == "Runtime.exceptionThrown":
                bad.append(json.dumps(params["exceptionDetails"])[:500])
            elif method == "Log.entryAdded" and params["entry"]["level"] in ("error", "warning"):
                bad.append(params["entry"]["text"])
            elif method == "Runtime.consoleAPICalled" and params["type"] in ("error", "warning"):
                bad.append(json.dumps(params["args"])[:500])
        return bad

    def picture(self, path: Path, whole: bool = True) -> None:
        """Write what is shown, or all of the page, as PNG."""
        got = self.ask("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(got["data"]))


@contextmanager
def page() -> Iterator[Page]:
    """Yield a page of a browser that ends with the block."""
    path = found()
    assert path is not None
    to_read, to_send = os.pipe()
    from_read, from_send = os.pipe()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as home:
        # The protocol's descriptors are 3 and 4, by a shell that moves them there.
        moved = f'exec {path} "$@" 3<&{to_read} 4>&{from_send}'
        flags = (
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--hide-scrollbars",
            "--disable-dev-shm-usage",
            "--remote-debugging-pipe",
            f"--user-data-dir={home}",
        )
        process = subprocess.Popen(
            ["bash", "-c", moved, "browser", *flags],
            pass_fds=(to_read, from_send),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(to_read)
        os.close(from_send)
        try:
            opened = Page(to_send, from_read)
            opened.begin()
            yield opened
        finally:
            process.terminate()
            process.wait(30)
            os.close(to_send)
            os.close(from_read)

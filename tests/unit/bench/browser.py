"""Headless Chromium for tests and screenshots, controlled through its DevTools socket."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import importlib.util
import itertools
import json
import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.request import Request, urlopen

from tornado.websocket import websocket_connect

NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
HOW = "no Chromium here: run ./setup.sh --for developing or apt-get install chromium-headless-shell"
OPTIONS = (
    "--headless", "--no-sandbox", "--disable-gpu-sandbox", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--disable-dev-shm-usage", "--hide-scrollbars",
    "--no-first-run", "--remote-debugging-port=0", "--remote-allow-origins=*",
    "--disable-background-networking", "--disable-component-update",
)  # fmt: skip
START, ANSWER = 60.0, 200.0  # s of wall time


def chromium() -> str | None:
    """Return the path of the program; None if it is not installed."""
    return next(filter(None, map(shutil.which, NAMES)), None)


AUDIT = """axe.run(document, {resultTypes: ["violations"]}).then((found) => found.violations.map(
  (v) => `${v.id}: ${v.help}: ${v.nodes.slice(0, 3).map((n) => n.html.slice(0, 160) + " "
    + n.any.map((a) => a.message).join("; ")).join(" | ")}`))"""

# errors of an expression whose page was replaced by another one
NAVIGATED = ("Inspected target navigated", "Execution context was destroyed")


class NavigatedError(RuntimeError):
    """The page was replaced by another one."""


class Browser(contextlib.AbstractContextManager):
    """Browser with a temporary profile; it ends with the `with` block."""

    def __init__(self, size: tuple[int, int] = (1440, 900)) -> None:
        program = chromium()
        if program is None:
            raise RuntimeError(HOW)
        self._profile = tempfile.TemporaryDirectory(prefix="browser", ignore_cleanup_errors=True)
        self._loop = asyncio.new_event_loop()
        self._process = subprocess.Popen(
            [program, *OPTIONS, f"--window-size={size[0]},{size[1]}",
             f"--user-data-dir={self._profile.name}", "about:blank"],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            start_new_session=True,  # Debian's is a script, which a signal would end alone
        )  # fmt: skip
        self._size = size
        file = Path(self._profile.name) / "DevToolsActivePort"
        end = time.monotonic() + START
        while not (file.is_file() and file.read_text().count("\n")):
            if time.monotonic() > end or self._process.poll() is not None:
                self.close()
                raise RuntimeError("Chromium did not start")
            time.sleep(0.05)
        self._port = int(file.read_text().splitlines()[0])

    def open(self, address: str) -> Tab:
        """Open an address in a new tab, and return the tab."""
        asked = Request(f"http://127.0.0.1:{self._port}/json/new?about:blank", method="PUT")
        with urlopen(asked, timeout=ANSWER) as answer:
            tab = Tab(self._loop, json.load(answer)["webSocketDebuggerUrl"])
        tab.resize(*self._size)
        tab.call("Page.enable")
        tab.call("Page.navigate", url=address)
        return tab

    def close(self) -> None:
        """Stop the browser and all its processes."""
        for number in (signal.SIGTERM, signal.SIGKILL):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, number)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(5.0)
        self._loop.close()
        self._profile.cleanup()

    def __exit__(self, *_: object) -> None:
        self.close()


class Tab:
    """A tab of the browser."""

    def __init__(self, loop: asyncio.AbstractEventLoop, address: str) -> None:
        self._loop, self._numbers = loop, itertools.count(1)
        self._socket = self._run(lambda: websocket_connect(address, max_message_size=2**27))

    def _run(self, begin: Callable[[], Any]) -> Any:
        async def wait() -> Any:
            return await asyncio.wait_for(begin(), ANSWER)

        return self._loop.run_until_complete(wait())

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a DevTools command, and return its answer."""
        number = next(self._numbers)
        message = json.dumps({"id": number, "method": method, "params": parameters})
        self._run(lambda: self._socket.write_message(message))
        while True:
            text = self._run(self._socket.read_message)
            if text is None:
                raise RuntimeError(f"{method}: the page is gone")
            answer = json.loads(text)
            if answer.get("id") == number:
                if "error" in answer:
                    message = answer["error"]["message"]
                    kind = NavigatedError if message.startswith(NAVIGATED) else RuntimeError
                    raise kind(f"{method}: {message}")
                return answer["result"]

    def js(self, expression: str) -> Any:
        """Return the value of an expression; a promise is awaited."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True,
                           awaitPromise=True)  # fmt: skip
        if "exceptionDetails" in answer:
            told = answer["exceptionDetails"]
            raise RuntimeError(told.get("exception", {}).get("description", told["text"]))
        return answer["result"].get("value")

    def wait(self, expression: str, timeout: float = 20.0) -> Any:
        """Wait for the first true value of an expression, and return it; the page may change."""
        end = time.monotonic() + timeout
        while True:
            with contextlib.suppress(NavigatedError):
                if value := self.js(expression):
                    return value
            if time.monotonic() > end:
                raise AssertionError(f"waited {timeout:g} s in vain for {expression}")
            time.sleep(0.1)

    def resize(self, width: int, height: int = 900) -> None:
        """Set the size of the window, px; a narrow window emulates a telephone."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height,
                  deviceScaleFactor=1, mobile=width < 500)  # fmt: skip

    def mouse(self, kind: str, x: float, y: float, held: bool = False) -> None:
        """Send a mouse event, Pressed, Moved or Released, at a position in the window."""
        self.call("Input.dispatchMouseEvent", type=f"mouse{kind}", x=x, y=y, clickCount=1,
                  button="left" if held or kind != "Moved" else "none",
                  buttons=int(held or kind == "Pressed"))  # fmt: skip

    def audit(self) -> list[str]:
        """Return the accessibility problems that axe-core finds."""
        folder = Path(importlib.util.find_spec("axe_core_python").submodule_search_locations[0])
        self.js((folder / "axe.min.js").read_text(encoding="utf-8") + "; true")
        return self.js(AUDIT)

    def screenshot(self) -> bytes:
        """Return the visible part of the page as PNG."""
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])

    def close(self) -> None:
        """Close the tab."""
        async def end() -> None:  # in its loop, which the socket asks for
            await self._socket.write_message(json.dumps({"id": 0, "method": "Page.close"}))
            self._socket.close()

        self._run(end)

"""A headless Chromium driven as by hand and eye: real pointer and keys, several tabs, screenshots.

It speaks the protocol of Chromium's developer tools through a pipe, so that no library is needed.
"""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")

PATIENCE = 30.0
"""Seconds after which what was waited for counts as failed."""


class Chromium:
    """A browser of its own, which knows no other address than this machine."""

    def __init__(self, profile: Path) -> None:
        to_browser, self._out = os.pipe()
        self._in, from_browser = os.pipe()
        command = [str(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-pipe"]
        command += [f"--user-data-dir={profile}", "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"]
        command += ["--no-first-run", "--disable-background-networking", "--disable-component-update"]

        def ends() -> None:
            # The browser reads from descriptor 3 and writes to 4.
            inward, outward = os.dup(to_browser), os.dup(from_browser)
            os.dup2(inward, 3)
            os.dup2(outward, 4)

        self._process = subprocess.Popen(
            command, preexec_fn=ends, close_fds=False, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        os.close(to_browser)
        os.close(from_browser)
        self._number, self._rest = 0, b""

    def call(self, method: str, session: str | None = None, **arguments: Any) -> dict[str, Any]:
        """Ask the browser for something, and return its answer."""
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": arguments}
        if session is not None:
            message["sessionId"] = session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        while True:
            told = json.loads(self._message())
            if told.get("id") == self._number:
                assert "error" not in told, (method, told["error"])
                return dict(told["result"])

    def _message(self) -> bytes:
        while b"\0" not in self._rest:
            more = os.read(self._in, 1 << 16)
            assert more, "Chromium has ended"
            self._rest += more
        first, self._rest = self._rest.split(b"\0", 1)
        return first

    def open(self, address: str, width: int = 1400, height: int = 900) -> Tab:
        """Return a new tab at an address."""
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        tab = Tab(self, session)
        tab.size(width, height)
        tab.go(address)
        return tab

    def close(self) -> None:
        """End the browser."""
        for end in (self._out, self._in):
            os.close(end)
        self._process.terminate()
        self._process.wait(20)


class Tab:
    """One tab."""

    def __init__(self, browser: Chromium, session: str) -> None:
        self._browser, self._session = browser, session
        self._call("Page.enable")
        remember = "window.wrong=[];addEventListener('error',e=>wrong.push(e.message));"
        remember += "addEventListener('unhandledrejection',e=>wrong.push(String(e.reason)))"
        self._call("Page.addScriptToEvaluateOnNewDocument", source=remember)

    def _call(self, method: str, **arguments: Any) -> dict[str, Any]:
        return self._browser.call(method, self._session, **arguments)

    def size(self, width: int, height: int) -> None:
        """Give the window another size."""
        numbers = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self._call("Emulation.setDeviceMetricsOverride", **numbers)

    def go(self, address: str) -> None:
        """Go to an address, and wait until its page is there."""
        self._call("Page.navigate", url=address)
        self.until("document.readyState === 'complete' && location.href !== 'about:blank'")

    def run(self, program: str) -> Any:
        """Return the value of an expression of the page's language; promises are awaited."""
        told = self._call("Runtime.evaluate", expression=program, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in told, told["exceptionDetails"]
        return told["result"].get("value")

    def until(self, program: str, seconds: float = PATIENCE) -> None:
        """Wait until an expression is true."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if self.run(f"Boolean({program})"):
                return
            time.sleep(0.05)
        raise AssertionError(f"in vain: {program}; the page says {self.run('document.body.innerText')[:600]}")

    def drag(self, begin: tuple[float, float], end: tuple[float, float]) -> None:
        """Press the pointer at one point, move it to another one, and let go."""
        # A tab behind another one answers its pointer after ten seconds.
        self._call("Page.bringToFront")
        middle = [(b + e) / 2 for b, e in zip(begin, end)]
        self._pointer("mousePressed", *begin)
        self._pointer("mouseMoved", *middle)
        self._pointer("mouseMoved", *end)
        self._pointer("mouseReleased", *end)

    def _pointer(self, kind: str, x: float, y: float) -> None:
        button = {"button": "left", "buttons": 0 if kind == "mouseReleased" else 1, "clickCount": 1}
        self._call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **button)

    def click(self, selector: str) -> None:
        """Click the middle of an element."""
        self.run(f"document.querySelector({json.dumps(selector)}).scrollIntoView({{block:'nearest'}})")
        x, y = self.run(
            f"(r => [r.x + r.width / 2, r.y + r.height / 2])"
            f"(document.querySelector({json.dumps(selector)}).getBoundingClientRect())"
        )
        self.drag((x, y), (x, y))

    def press(self, key: str) -> None:
        """Press a key and let it go."""
        for kind in ("keyDown", "keyUp"):
            self._call("Input.dispatchKeyEvent", type=kind, key=key, code=key)

    def type(self, text: str) -> None:
        """Write into what has the focus."""
        self._call("Input.insertText", text=text)

    def screenshot(self, path: Path) -> None:
        """Save what is seen as PNG."""
        path.write_bytes(base64.b64decode(self._call("Page.captureScreenshot", format="png")["data"]))

"""Chromium without a window, driven by its own protocol: real pointers and keys, real time."""

import base64
import contextlib
import itertools
import json
import shutil
import subprocess
import time
import urllib.request
from importlib.util import find_spec

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
needs_chromium = pytest.mark.skipif(
    CHROMIUM is None or find_spec("websockets") is None,
    reason="needs chromium on the PATH, and websockets to control it",
)
DRAWN = """document.readyState === "complete" && (document.getElementById("data") === null
  || document.documentElement.dataset.drawn !== undefined)"""
SCRIPT = """(async () => {
  const found = {}, frame = () => new Promise((resolve) => setTimeout(resolve, 120));
  %s
  return found;
})()"""


def open_page(file, script, scratch, width=1000, height=900, dark=False, address=""):
    """Return what `script` put into `found`, and under ``wrong`` every error and warning.

    The page is `width` by `height` px; `address` is what follows its name, as in "#t=3".
    """
    page = Page(scratch, file.as_uri() + address, width, height, dark)
    try:
        page.until(lambda: page.errors or page.find(DRAWN))
        return page.find(SCRIPT % script) | {"wrong": page.errors}
    finally:
        page.close()


class Page:
    """A page that is open in Chromium."""

    def __init__(self, scratch, address, width=1200, height=800, dark=False):
        words = ["--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-port=0"]
        words += [f"--user-data-dir={scratch / 'profile'}", f"--window-size={width},{height}"]
        port = scratch / "profile" / "DevToolsActivePort"
        port.unlink(missing_ok=True)  # of an earlier page
        self.errors, self._ids, self._stack = [], itertools.count(1), contextlib.ExitStack()
        process = subprocess.Popen(
            [CHROMIUM, *words, "about:blank"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        self._stack.enter_context(process)
        self._stack.callback(process.terminate)
        try:
            self._open(port, address, width, height, dark)
        except BaseException:
            self.close()
            raise

    def _open(self, file, address, width, height, dark):
        self.until(lambda: file.exists() and "\n" in file.read_text())
        port = file.read_text().splitlines()[0]
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list") as listed:
            (page, *_) = [one for one in json.load(listed) if one["type"] == "page"]
        from websockets.sync.client import connect

        talking = connect(page["webSocketDebuggerUrl"], max_size=None)
        self._socket = self._stack.enter_context(talking)
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        self.call("Emulation.setDeviceMetricsOverride", **metrics)
        self.call("Page.navigate", url=address)

    def call(self, method, **parameters):
        number = next(self._ids)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while (said := self._hear()).get("id") != number:
            pass
        assert "error" not in said, said
        return said["result"]

    def _hear(self):
        said = json.loads(self._socket.recv(timeout=90))
        kind = said.get("params", {}).get("type")
        if said.get("method") in ("Runtime.exceptionThrown", "Log.entryAdded") or (
            said.get("method") == "Runtime.consoleAPICalled" and kind in ("error", "warning")
        ):
            self.errors.append(said["params"])
        return said

    def reload(self):
        """Load the page again, and wait until it is there: till then nothing can be asked."""
        self.call("Page.reload")
        self._loaded()

    def open(self, address):
        """Go to another page, and wait until it is there."""
        self.call("Page.navigate", url=address)
        self._loaded()

    def _loaded(self):
        while self._hear().get("method") != "Page.loadEventFired":
            pass

    def find(self, script):
        """What an expression in the page is worth."""
        found = self.call(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def until(self, condition, longest=90.0):
        """Wait until an expression, or a function, is true; return what it is worth."""
        end = time.monotonic() + longest
        while not (found := condition() if callable(condition) else self.find(condition)):
            assert time.monotonic() < end, condition
            time.sleep(0.05)
        return found

    def drag(self, label, dx, dy, steps=8):
        """Drag what has a label, by pixels, as a hand would."""
        box = self.find(
            f"(() => {{ const b = document.querySelector('[aria-label^=\"{label},\"]')"
            ".getBoundingClientRect(); return [b.x + b.width / 2, b.y + b.height / 2]; })()"
        )
        pointer = {"button": "left", "buttons": 1, "clickCount": 1}
        self.call("Input.dispatchMouseEvent", type="mousePressed", x=box[0], y=box[1], **pointer)
        for k in range(1, steps + 1):
            x, y = box[0] + dx * k / steps, box[1] + dy * k / steps
            self.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y, **pointer)
            time.sleep(0.02)
        self.call("Input.dispatchMouseEvent", type="mouseReleased", x=x, y=y, **pointer)

    def key(self, key, code, down=True):
        """Press a key, or let it go."""
        kind = "rawKeyDown" if down else "keyUp"
        numbers = {"ArrowLeft": 37, "ArrowUp": 38, "ArrowRight": 39, " ": 32}
        number = numbers.get(key, 0)
        self.call(
            "Input.dispatchKeyEvent", type=kind, key=key, code=code, windowsVirtualKeyCode=number
        )

    def picture(self, file):
        """Save what is to be seen."""
        file.write_bytes(base64.b64decode(self.call("Page.captureScreenshot")["data"]))

    def close(self):
        """Close the page and the browser."""
        self._stack.close()

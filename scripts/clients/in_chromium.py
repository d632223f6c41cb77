"""Opens a page in headless Chromium, takes steps in it, and saves pictures of it.

    python in_chromium.py PAGE OUT STEPS [--size 1280 800] [--phone] [--chromium PATH]

STEPS is a JSON list of steps, one key each: {"run": JAVASCRIPT} whose value is kept, {"until":
JAVASCRIPT} waits until it is true, {"click": SELECTOR}, {"seek": [SELECTOR, JAVASCRIPT]} clicks
every two seconds until it is true, {"key": KEY}, {"picture": NAME} writes
OUT/NAME.png, {"sleep": SECONDS}. The last line that is written has the version of the browser,
the values, what the page logged as an error, and every address that it asked for, as JSON.
"""

import argparse
import base64
import json
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
PATIENCE = 60.0
"""Longest time of a step, seconds: pictures are drawn without a graphics card."""


def main() -> None:
    parser = argparse.ArgumentParser(description="A page in headless Chromium.")
    parser.add_argument("page", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("steps")
    parser.add_argument("--size", type=int, nargs=2, default=(1280, 800))
    parser.add_argument("--phone", action="store_true")
    parser.add_argument("--chromium", default=found())
    given = parser.parse_args()
    if given.chromium is None:
        sys.exit(f"no Chromium is installed: looked for {', '.join(NAMES)}")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        words = [
            given.chromium, "--headless=new", "--no-sandbox", "--disable-gpu-sandbox",
            "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--hide-scrollbars",
            "--no-first-run", "--disable-extensions", "--disable-background-networking",
            "--disable-dev-shm-usage", "--remote-debugging-port=0", f"--user-data-dir={profile}",
            f"--window-size={given.size[0]},{given.size[1]}", "about:blank",
        ]  # fmt: skip
        browser = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            said = Session(address(Path(profile))).visit(given)
        finally:
            browser.terminate()
            browser.wait(10)
    print(json.dumps(said))


def found() -> str | None:
    """Find the first Chromium on the path."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


def address(profile: Path) -> str:
    """Wait for the browser to listen; return the address of its developer tools."""
    deadline = time.monotonic() + PATIENCE
    port = profile / "DevToolsActivePort"
    while time.monotonic() < deadline:
        lines = port.read_text().splitlines() if port.exists() else []
        if len(lines) == 2:
            return f"ws://127.0.0.1:{lines[0]}{lines[1]}"
        time.sleep(0.05)
    sys.exit(f"Chromium did not start within {PATIENCE} s")


class Session:
    """A visit to one page, by the protocol of Chromium's developer tools."""

    def __init__(self, where: str) -> None:
        self.socket: ClientConnection = connect(where, max_size=None)
        self.count = 0
        self.session: str | None = None
        self.errors: list[str] = []
        self.addresses: list[str] = []

    def visit(self, given: argparse.Namespace) -> dict[str, Any]:
        """Open the page, take the steps; return values, errors and requested addresses."""
        version = self.ask("Browser.getVersion")["product"]
        target = self.ask("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.ask("Target.attachToTarget", targetId=target, flatten=True)[
            "sessionId"
        ]
        for domain in ("Page", "Runtime", "Network"):
            self.ask(f"{domain}.enable")
        width, height = given.size
        self.ask(
            "Emulation.setDeviceMetricsOverride", width=width, height=height,
            deviceScaleFactor=1, mobile=given.phone,
        )  # fmt: skip
        self.ask("Page.navigate", url=given.page.resolve().as_uri())
        values = [self.step(step, given.out) for step in json.loads(given.steps)]
        return {
            "version": version,
            "values": [value for value in values if value is not None],
            "errors": self.errors,
            "addresses": [a for a in self.addresses if not re.match("(data|blob|file):", a)],
        }

    def step(self, step: dict[str, Any], out: Path) -> Any:
        """Take one step; return its value, None for most kinds."""
        ((kind, what),) = step.items()
        if kind == "run":
            return self.run(what)
        if kind == "until":
            deadline = time.monotonic() + PATIENCE
            while not self.run(what):
                if time.monotonic() > deadline:
                    sys.exit(f"never true: {what}\n{self.errors}")
                time.sleep(0.1)
        elif kind == "seek":
            deadline = time.monotonic() + PATIENCE
            while not self.run(what[1]):
                if time.monotonic() > deadline:
                    sys.exit(f"never true: {what[1]}")
                self.step({"click": what[0]}, out)
                time.sleep(2)
        elif kind == "click":
            box = self.run(
                f"(b => [b.left + b.width / 2, b.top + b.height / 2])"
                f"(document.querySelector({json.dumps(what)}).getBoundingClientRect())"
            )
            for event in ("mousePressed", "mouseReleased"):
                self.ask(
                    "Input.dispatchMouseEvent", type=event, x=box[0], y=box[1], button="left",
                    clickCount=1,
                )  # fmt: skip
        elif kind == "key":
            for event in ("keyDown", "keyUp"):
                self.ask("Input.dispatchKeyEvent", type=event, key=what, code=what, text=" "
                         if what == "Space" and event == "keyDown" else "")  # fmt: skip
        elif kind == "picture":
            data = self.ask("Page.captureScreenshot", format="png")["data"]
            (out / f"{what}.png").write_bytes(base64.b64decode(data))
        elif kind == "sleep":
            time.sleep(what)
        else:
            sys.exit(f"no such step: {kind}")
        return None

    def run(self, script: str) -> Any:
        """Run a script in the page; return its value."""
        found = self.ask("Runtime.evaluate", expression=script, returnByValue=True,
                         awaitPromise=True)  # fmt: skip
        if "exceptionDetails" in found:
            sys.exit(f"{script}: {found['exceptionDetails']}")
        return found["result"].get("value")

    def ask(self, method: str, **params: Any) -> dict[str, Any]:
        """Send a command to the browser; return its answer, and note events meanwhile."""
        self.count += 1
        message: dict[str, Any] = {"id": self.count, "method": method, "params": params}
        if self.session is not None:
            message["sessionId"] = self.session
        self.socket.send(json.dumps(message))
        while True:
            answer = json.loads(self.socket.recv(timeout=PATIENCE))
            if answer.get("id") == self.count:
                if "error" in answer:
                    sys.exit(f"{method}: {answer['error']}")
                return answer["result"]
            self.note(answer)

    def note(self, event: dict[str, Any]) -> None:
        """Record an event: an error of the page, or an address that it requests."""
        params = event.get("params", {})
        if event.get("method") == "Runtime.exceptionThrown":
            self.errors.append(params["exceptionDetails"]["exception"].get("description", ""))
        elif event.get("method") == "Runtime.consoleAPICalled" and params["type"] == "error":
            self.errors.append(str([one.get("value") for one in params["args"]]))
        elif event.get("method") == "Network.requestWillBeSent":
            self.addresses.append(params["request"]["url"])


if __name__ == "__main__":
    main()

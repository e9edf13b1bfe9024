"""Recordings and the site are looked at in Chromium, where it is installed."""

from __future__ import annotations

import base64
import contextlib
import io
import itertools
import json
import os
import shutil
import socket
import subprocess
import sys
import time
import urllib.parse
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun_cli
from PIL import Image

from ssmr.types import FloatArray
from tests.conftest import Launch
from validation.compare import compare
from validation.report.palette import plant_colour

ROOT = Path(__file__).resolve().parents[1]
NAMES = ("chromium", "chromium-browser", "google-chrome")
CHROMIUM = next(filter(None, map(shutil.which, NAMES)), "")
PATIENCE = 240.0
"""A busy computer without a graphics card draws a first frame after so long [s]."""

PLOTS = 795
"""Where plots begin at a width of 1280 px [px]."""
LEGENDS = 1165
"""Where their legends begin [px]."""

pytestmark = [
    pytest.mark.skipif(not CHROMIUM, reason="Chromium is not installed"),
    pytest.mark.usefixtures("with_drawings"),
]


class Browser:
    """A page of a headless Chromium, led by its DevTools protocol over a pair of pipes."""

    def __init__(self, send: int, receive: int) -> None:
        self._send = send
        self._receive = receive
        self._numbers = itertools.count(1)
        self._left = b""
        target = self._call("Target.createTarget", {"url": "about:blank"})["targetId"]
        attach = {"targetId": target, "flatten": True}
        self._session = self._call("Target.attachToTarget", attach)["sessionId"]

    def _call(self, method: str, given: Mapping[str, Any], **session: str) -> dict[str, Any]:
        number = next(self._numbers)
        message = {"id": number, "method": method, "params": given} | session
        os.write(self._send, json.dumps(message).encode() + b"\0")
        while True:
            while b"\0" not in self._left:
                received = os.read(self._receive, 1 << 16)
                assert received, "Chromium has ended"
                self._left += received
            text, _, self._left = self._left.partition(b"\0")
            answer = json.loads(text)
            if answer.get("id") == number:
                assert "error" not in answer, answer["error"]
                return dict(answer["result"])

    def do(self, method: str, **given: Any) -> dict[str, Any]:
        """Call a method of the page."""
        return self._call(method, given, sessionId=self._session)

    def resize(self, width: int, height: int = 900) -> None:
        """Give the page a size [px]."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
        self.do("Emulation.setDeviceMetricsOverride", **size)

    def value(self, script: str) -> Any:
        """Return the value of a line of JavaScript."""
        return self.do("Runtime.evaluate", expression=script)["result"].get("value")

    def open(self, address: str) -> None:
        """Open an address and wait until it is loaded."""
        self.do("Page.navigate", url=address)
        until = time.monotonic() + PATIENCE
        while self.value("document.readyState") != "complete":
            assert time.monotonic() < until, f"{address} did not load"
            time.sleep(0.1)

    def picture(self) -> FloatArray:
        """Return the (height, width, 3) colours that the page shows, 0 to 255."""
        data = base64.b64decode(self.do("Page.captureScreenshot", format="png")["data"])
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"), dtype=np.float64)


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Browser]:
    """A page of a browser of its own, which draws without a graphics card."""
    with contextlib.ExitStack() as left:
        their_input, send = os.pipe()
        receive, their_output = os.pipe()
        left.callback(os.close, send)
        left.callback(os.close, receive)
        command = [
            "bash",
            "-c",
            f'exec "$0" "$@" 3<&{their_input} 4>&{their_output}',
            CHROMIUM,
            "--headless=new",
            "--no-sandbox",  # containers have none; only pages of this project are opened
            "--disable-dev-shm-usage",
            "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader",
            "--remote-debugging-pipe",
            f"--user-data-dir={tmp_path / 'browser'}",
        ]
        theirs = (their_input, their_output)
        process = subprocess.Popen(command, pass_fds=theirs, stderr=subprocess.DEVNULL)
        for end in theirs:
            os.close(end)
        left.callback(process.wait)
        left.callback(process.kill)
        yield Browser(send, receive)


def free_port() -> int:
    """A port of this computer that nobody listens on."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def wait_for_port(port: int) -> None:
    """Return when somebody listens on a port of this computer."""
    until = time.monotonic() + PATIENCE
    while True:
        with socket.socket() as one:
            if one.connect_ex(("127.0.0.1", port)) == 0:
                return
        assert time.monotonic() < until, f"nobody listens on port {port}"
        time.sleep(0.1)


def shown(picture: FloatArray, name: str) -> FloatArray:
    """The (n, 2) places, right and down [px], of pixels in the colour of a plant."""
    near = np.abs(picture - np.array(plant_colour(name))).max(axis=2) < 24.0
    return np.argwhere(near)[:, ::-1].astype(np.float64)


def test_the_web_viewer_shows_robots_and_lines(
    browser: Browser, launch: Launch, tmp_path: Path
) -> None:
    """Each plot has its lines, and none runs below the legend."""
    plants = ("mujoco", "kinematic")
    compare("traj4", plants=plants).save(tmp_path)
    ports = [free_port(), free_port()]
    options = ["--bind", "127.0.0.1", "--port", str(ports[0]), "--web-viewer-port", str(ports[1])]
    file = str(tmp_path / "compare.rrd")
    command = [str(Path(rerun_cli.__file__).with_name("rerun")), file, "--serve-web", *options]
    launch(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    stream = urllib.parse.quote(f"rerun+http://localhost:{ports[0]}/proxy", safe="")
    browser.resize(1280)
    wait_for_port(ports[1])
    browser.open(f"http://127.0.0.1:{ports[1]}?url={stream}")
    # errors, yaw rates, and wheel loads, one of which has the colour of coulomb
    panels = {"kinematic": (64, 300), "mujoco": (343, 578), "coulomb": (621, 858)}
    until = time.monotonic() + PATIENCE
    widths = dict.fromkeys(panels, 0.0)
    while min(widths.values()) < 250.0:
        assert time.monotonic() < until, f"lines are {widths} px wide"
        time.sleep(1.0)
        picture = browser.picture()
        for name, (top, bottom) in panels.items():
            right = shown(picture[top:bottom, PLOTS:LEGENDS], name)[:, 0]
            widths[name] = float(np.ptp(right)) if len(right) else 0.0
    for name, (top, bottom) in panels.items():
        gap = shown(picture[top:bottom, LEGENDS - 20 : LEGENDS], name)
        assert not len(gap), f"a line of {name} reaches the legend"
    assert len(shown(picture[64:490, :PLOTS], "mujoco")) > 50, "no path is shown"


@pytest.mark.slow
def test_no_page_is_wider_than_a_phone(browser: Browser, tmp_path: Path) -> None:
    """At 390 px wide tables, pictures and equations scroll by themselves, not the page."""
    pytest.importorskip("furo")
    pytest.importorskip("myst_parser")
    build = [sys.executable, "-m", "sphinx", "-q", "-b", "html", str(ROOT / "docs"), str(tmp_path)]
    subprocess.run(build, check=True, cwd=ROOT)
    pages = sorted(tmp_path.glob("*.html"))
    assert len(pages) > 30
    browser.resize(390)
    wide = []
    for page in pages:
        browser.open(page.as_uri())
        if browser.value("document.documentElement.scrollWidth") > 390:
            wide.append(page.name)
    assert not wide

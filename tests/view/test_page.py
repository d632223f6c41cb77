"""The page in headless Chromium, desktop and phone size: looked at, its layers switched.

Needs a Chromium on the path. `RECON_PICTURES=1` writes the pictures of tests/golden/page anew, to
be looked at before they are committed.
"""

import functools
import json
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from benchmarks.protocol import ROOT
from recon.body.model import BodyModel
from recon.formats.motions import load_motion
from recon.view import Figure, Show
from recon.view.html import write_html
from recon.view.scene import GREY, Points
from tests.cli.test_hostile_names import NAMES

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
CLIENT = ROOT / "scripts" / "clients" / "in_chromium.py"
GOLDEN = ROOT / "tests" / "golden" / "page"
FEET = 590
"""Row of the feet in the desktop's picture, below which the shadow lies."""
BLOCK = 10
"""Pixels along each side of the blocks in which pictures are compared."""
READY = {"until": "document.querySelector('#recon-legend.switched') !== null && "
                  "Object.keys(window.__viserMutable.skinnedMeshState).length >= 6"}  # fmt: skip
SETTLED = {"sleep": 1.5}
MIDDLE = {
    "seek": [
        ".mantine-Slider-root",
        "Math.abs(document.querySelectorAll('input')[1].value - 1) < 0.002",
    ]
}
"""Clicks into the middle of the timeline, until it stands there: while the film plays, a click
pauses it late where pictures are drawn without a graphics card."""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not any(shutil.which(name) for name in BROWSERS),
        reason=f"no Chromium is installed ({', '.join(BROWSERS)}): pages are looked at in it",
    ),
]


@functools.cache
def show() -> Show:
    """Two seconds of the demo's walk with everything that a page can show but cameras."""
    body = BodyModel.load()
    with resources.as_file(resources.files("recon") / "assets" / "demo.npz") as path:
        motion = load_motion(path).motion.window(0, 60)
    joints = body.pose(motion).joints
    noise = 0.02 * torch.randn(joints.shape, generator=torch.Generator().manual_seed(0))
    visible = torch.ones(joints.shape[:2], dtype=torch.bool)
    visible[:, 4] = False
    contacts = torch.zeros(60, 22)
    contacts[:, 7] = 1
    fitted = Figure(body, motion, "fit", contacts=contacts, joint_std=torch.full((60, 22), 0.04))
    true = motion.replace(translation=motion.translation + torch.tensor([0.004, 0.0, 0.0]))
    truth = Figure(body, true, "truth", colour=GREY, opacity=0.45)
    return Show("A walk", (fitted, truth), Points(joints + noise, visible, joints))


def visited(
    steps: list[dict[str, Any]], out: Path, *more: str, shown: Show | None = None
) -> dict[str, Any]:
    """What the browser says after some steps; pictures are in the folder."""
    page = out / "page.html"
    write_html(page, shown or show())
    words = [sys.executable, str(CLIENT), str(page), str(out), json.dumps(steps), *more]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=400)
    assert done.returncode == 0, done.stderr[-3000:]
    return json.loads(done.stdout.splitlines()[-1])


def label(word: str) -> str:
    number = [layer.word for layer in show().layers].index(word) + 1
    return f"#recon-legend label:nth-of-type({number})"


def picture(out: Path, name: str) -> np.ndarray:
    found = cv2.imread(str(out / f"{name}.png"))
    assert found is not None, name
    return cv2.cvtColor(found, cv2.COLOR_BGR2RGB).astype(float)


def blocks(image: np.ndarray) -> np.ndarray:
    """Mean colours of blocks, which no edge that is drawn a little otherwise changes much."""
    height, width = (BLOCK * (side // BLOCK) for side in image.shape[:2])
    cut = image[:height, :width].reshape(height // BLOCK, BLOCK, width // BLOCK, BLOCK, 3)
    return cut.mean((1, 3))


def unlike(a: np.ndarray, b: np.ndarray) -> float:
    """Share of the blocks whose colour differs visibly."""
    return float((np.abs(blocks(a) - blocks(b)).max(-1) > 12).mean())


def as_before(out: Path, name: str) -> None:
    """A picture is that which was looked at and committed."""
    GOLDEN.mkdir(exist_ok=True)
    if os.environ.get("RECON_PICTURES"):
        seen = cv2.imread(str(out / f"{name}.png"))
        assert seen is not None, name
        cv2.imwrite(str(GOLDEN / f"{name}.jpg"), seen)
    looked_at = cv2.imread(str(GOLDEN / f"{name}.jpg"))
    assert looked_at is not None, f"no picture of before: {name}"
    before = cv2.cvtColor(looked_at, cv2.COLOR_BGR2RGB).astype(float)
    assert unlike(picture(out, name), before) < 0.02, f"{out}: look at {name}.png"


UNCOVERED = """[...document.querySelectorAll('#recon-legend summary, #recon-legend label')].every(
  e => { const b = e.getBoundingClientRect();
         const top = document.elementFromPoint(b.left + 12, b.top + b.height / 2);
         return top !== null && top.closest('#recon-legend') !== null; })"""
"""Whether nothing lies over title and legend."""
SHOWN = """Object.fromEntries(Object.entries(window.__viserSceneTree.getState()).map(
  ([name, node]) => [name, node.effectiveVisibility]))"""


@functools.cache
def desktop() -> tuple[Path, dict[str, Any]]:
    """One visit: a picture while it plays, and of every layer switched, one after the other."""
    steps: list[dict[str, Any]] = [READY, {"sleep": 8.0}, {"picture": "playing"}]
    steps += [MIDDLE, SETTLED, {"picture": "desktop"}, {"run": UNCOVERED}]
    switches = [{"click": label(layer.word)} for layer in show().layers]
    for switch, layer in zip(switches, show().layers, strict=True):
        steps += [switch, SETTLED, {"picture": f"switched {layer.word}"}, {"run": SHOWN}]
    steps += [*switches, SETTLED, {"picture": "again"}]
    steps += [{"click": "#recon-legend label:last-of-type"}, SETTLED, {"picture": "stands"}]
    # a layer that is switched off stays so when the film begins anew
    steps += [switches[0], {"key": "Space"}, {"sleep": 6.0}, {"run": SHOWN}]
    out = Path(tempfile.mkdtemp())
    return out, visited(steps, out, "--size", "1280", "800")


def test_the_page_works_offline_without_errors() -> None:
    _, said = desktop()
    assert said["errors"] == []
    assert said["addresses"] == []


def test_the_page_looks_as_it_did_when_somebody_looked_at_it() -> None:
    out, _ = desktop()
    as_before(out, "desktop")


def test_nothing_hides_title_and_legend() -> None:
    """A notice of the viewer lay over them."""
    _, said = desktop()
    assert said["values"][0] is True


def test_every_layer_is_switched_off_and_on() -> None:
    out, said = desktop()
    before = whole = picture(out, "desktop")
    for layer, shown in zip(show().layers, said["values"][1:], strict=False):
        assert [shown[node] for node in layer.nodes] == [not layer.shown] * len(layer.nodes)
        after = picture(out, f"switched {layer.word}")
        changed = np.abs(before[:, 260:] - after[:, 260:]).max(-1) > 30  # right of the legend
        assert changed.sum() > 60, layer.word
        before = after
    assert unlike(picture(out, "again"), whole) < 0.01


def test_a_layer_stays_switched_off_when_the_film_begins_anew() -> None:
    _, said = desktop()
    assert said["values"][-1]["/world/fit/body"] is False
    assert said["values"][-1]["/world/truth/body"] is True


def test_truth_and_result_are_told_apart_everywhere() -> None:
    """Two skins at one place fought for the same depth: patches of one and of the other.

    The truth is drawn as a net, which shows the result through its meshes everywhere.
    """
    out, _ = desktop()
    both = blocks(picture(out, "desktop"))
    truth, neither = (blocks(picture(out, f"switched {word}")) for word in ("fit", "truth"))
    bodies = np.abs(truth - neither).max(-1) > 15
    bodies[FEET // BLOCK :] = False  # the truth has a shadow there
    bluish = both[bodies][:, 2] - both[bodies][:, 0]
    assert bodies.sum() > 100
    assert (bluish > 8).mean() > 0.85


def test_points_lie_on_the_body_while_it_plays() -> None:
    """On a slow computer points lagged behind the body by up to two metres."""
    out, _ = desktop()
    image = picture(out, "playing")[:740, 300:960]
    red, green, blue = np.moveaxis(image, -1, 0)
    points = (green > red + 40) & (green > blue - 5)
    body = (blue > red + 15) & (blue > green + 5)
    assert points.sum() > 200
    near = cv2.dilate(body.astype(np.uint8), np.ones((25, 25), np.uint8)) > 0
    assert near[points].mean() > 0.75  # some lie a few centimetres off, as they are noisy


def test_the_camera_follows_the_person_until_told_not_to() -> None:
    """People walked out of the picture."""
    out, _ = desktop()

    def middle(name: str) -> float:
        image = picture(out, name)[:740, 300:960]
        red, green, blue = np.moveaxis(image, -1, 0)
        return float(np.nonzero((blue > red + 15) & (blue > green + 5))[1].mean()) + 300

    assert abs(middle("desktop") - 640) < 60
    assert abs(middle("stands") - middle("desktop")) > 20


def test_the_page_fits_a_phone() -> None:
    """The legend is a title there until it is opened; it would cover half of the picture."""
    wide = "document.documentElement.scrollWidth <= innerWidth"
    steps: list[dict[str, Any]] = [READY, {"sleep": 6.0}, MIDDLE, SETTLED, {"picture": "phone"}]
    steps += [{"run": wide}, {"run": "document.querySelector('#recon-legend details').open"}]
    steps += [{"click": "#recon-legend summary"}, {"sleep": 0.5}, {"picture": "phone_legend"}]
    steps += [{"run": UNCOVERED}, {"click": label("observed point")}, SETTLED]
    steps += [{"picture": "phone_switched"}]
    out = Path(tempfile.mkdtemp())
    said = visited(steps, out, "--size", "390", "844", "--phone")
    assert said["errors"] == []
    assert said["values"] == [True, False, True]
    as_before(out, "phone")
    as_before(out, "phone_legend")
    changed = np.abs(picture(out, "phone_legend") - picture(out, "phone_switched")).max(-1) > 30
    assert changed.sum() > 200


@pytest.mark.parametrize("part", range(0, len(NAMES), 4))
def test_no_name_is_run(part: int, tmp_path: Path) -> None:
    """Names whose scripts would change the title of the page."""
    word = "".join(NAMES[part : part + 4])
    figure = replace(show().figures[0], name=word, contacts=None, joint_std=None)
    steps = [{"until": "document.querySelector('#recon-legend.switched') !== null"}, SETTLED,
             {"run": "document.title"}]  # fmt: skip
    said = visited(steps, tmp_path, shown=Show(word, (figure,)))
    assert said["errors"] == []
    assert said["values"][0] != "1"

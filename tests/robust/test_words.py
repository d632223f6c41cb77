"""What is refused at the front door, by which error, in which words: one table.

A row is a call, the class of its error and words that its message must have, as a pattern. Words
are what a reader needs to go on: what was expected, what came, which argument or file.
"""

from collections.abc import Callable
from inspect import unwrap
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import recon
from recon.api.observations import clip_of
from tests.robust.doors import refused_by_command

JOINTS = np.random.default_rng(0).normal((0, 0, 1), 0.3, (8, 22, 3))
SEEN = np.ones((8, 22), bool)
NAMES = [f"point {k}" for k in range(22)]


def joints(values: np.ndarray = JOINTS, seen: np.ndarray = SEEN, **more: Any) -> recon.Joints3D:
    return recon.Joints3D(values, seen, **{"joints": range(22), "fps": 30.0} | more)


def with_nan() -> np.ndarray:
    values = JOINTS.copy()
    values[1, 2] = np.nan
    return values


def lost() -> recon.Keypoints2D:
    """Keypoints of a camera without a pose."""
    (seen,) = recon.simulate(clip(), "keypoints2d", frames=(0, 8))
    assert isinstance(seen, recon.Keypoints2D)
    camera = recon.Camera.create(np.diag((1500.0, 1500.0, 1.0)), seen.camera.image_size)
    return recon.Keypoints2D(seen.pixels[0], seen.confidence[0], seen.points, camera, fps=30.0)


def stored(**change: Any) -> Callable[[Path], object]:
    """An observation file with other arrays."""

    def call(folder: Path) -> object:
        arrays = {"kind": "joints3d", "positions": JOINTS, "visible": SEEN, "fps": 30.0,
                  "up_axis": "z", "names": np.array(NAMES)}  # fmt: skip
        np.savez(folder / "o.npz", **(arrays | change))
        return recon.load_observation(folder / "o.npz")

    return call


def fitted(**arguments: Any) -> Callable[[Path], object]:
    return lambda _: recon.fit(joints(), **({"prior": "pose"} | arguments))


def loaded(name: str, data: bytes = b"nothing", **arguments: Any) -> Callable[[Path], object]:
    """A file of these bytes, read as an observation."""

    def call(folder: Path) -> object:
        (folder / name).write_bytes(data)
        return recon.load_observation(folder / name, **arguments)

    return call


Row = tuple[Callable[[Path], object], type[Exception], str]
R, F, S, U, W = (
    recon.ReconError, recon.FormatError, recon.ObservationError, recon.UnitsError,
    recon.WeightsError,
)  # fmt: skip
ROWS: dict[str, Row] = {
    # arrays
    "millimetres": (lambda _: joints(1000 * JOINTS), U, "divide millimetres by 1000"),
    "other mask": (lambda _: joints(seen=SEEN[:, :5]), S, "visible: expected the shape"),
    "NaN that is said to be seen": (lambda _: joints(with_nan()), S, "NaN|finite"),
    "rate of zero": (lambda _: joints(fps=0.0), R, "fps"),
    "deviation of zero": (lambda _: joints(std=0.0), R, "got 0 at std"),
    "unknown keypoint": (
        lambda _: recon.Keypoints3D(JOINTS[:, :1], SEEN[:, :1], ["tail"], fps=30.0),
        R, "no keypoint is called tail",
    ),
    "focal below 0": (lambda _: recon.Camera.create(-np.eye(3), (9, 9)), R, "positive pix"),
    "image without size": (lambda _: recon.Camera.create(np.eye(3), (0, 10)), R, "image size"),
    # what is fitted
    "nothing": (lambda _: recon.fit([]), S, "nothing to fit"),
    "two clips": (lambda _: recon.fit(joints(np.stack([JOINTS] * 2), np.stack([SEEN] * 2))), S,
                  r"leading axes \(2,\)"),
    "arrays by name": (
        lambda _: clip_of({"positions": JOINTS}, recon.BodyModel.load()), S, "Joints3D.*got dict"),
    "no such observation": (lambda d: recon.fit(d / "none.npz"), FileNotFoundError, r"none\.npz"),
    # how it is fitted
    "unknown prior": (fitted(prior="humour"), W, "humour"),
    "prior that cannot be imported": (fitted(prior="nobody:Nothing"), W, "cannot be imported"),
    "unknown method": (fitted(prior="humor", method="roll"), R,
                       "by collocation or rollout or look, got 'roll'"),
    "method of a prior with one way": (fitted(method="roll"), R, "in one way only, got 'roll'"),
    "no ground under a prior that has one": (fitted(prior="humor", ground=None), R,
                                             "'humor' needs the ground.*prior 'pose'"),
    "physics without a ground": (fitted(ground=None, physics=1.0), R, "expected physics=0, got 1"),
    "a plane of NaN": (fitted(ground=(0.0, 0.0, float("nan"), 0.0)), R, "ground: expected"),
    "known ground without a camera's pose": (
        lambda _: recon.fit(lost(), "pose", ground="known"), R, "no pose"),
    "two noises for one sensor": (fitted(noise=[0.1, 0.2]), R, "noise: expected one number, or 1"),
    "one noise for metres and pixels": (
        lambda _: recon.fit([joints(), lost()], "pose", noise=0.02), S, "one number for each of"),
    "robust below zero": (fitted(robust=-1.0), R, "robust"),
    "no time": (fitted(max_seconds=0.0), R, "max_seconds"),
    "shape of two axes": (fitted(shape=[[1.0]]), R, "shape: expected"),
    "height in decimetres": (fitted(shape=17.5), R, "height of 1 to 2.5 metres, got 17.5"),
    "empty shape": (fitted(shape=recon.Shape()), R, "expected height, or a similar shape"),
    "no such start": (fitted(start="none.npz"), FileNotFoundError, r"none\.npz"),
    "no such body": (fitted(body="none.npz"), FileNotFoundError, "no such body model file"),
    "no such weights": (fitted(weights="none.safetensors"), FileNotFoundError, "none.safetensors"),
    "nothing in between": (fitted(between=(5.0, 6.0)), S, "5"),
    "rate of the result": (fitted(fps=-1.0), R, "fps"),
    # files
    "text as observation": (loaded("bad.txt"), F, "expected a film, an observation"),
    "damaged archive": (loaded("bad.npz", b"PK\x03\x04 and nothing"), F, r"bad\.npz"),
    "empty file": (loaded("bad.npz", b""), F, r"bad\.npz"),
    "damaged C3D": (loaded("bad.c3d"), F, r"bad\.c3d"),
    "detections without a rate": (
        loaded("a_keypoints.json", b'{"people": []}'), S, "--frame-rate"),
    "reader that cannot be imported": (loaded("a.bin", reader="nobody:Nothing"), R, "imported"),
    "reader that reads nothing": (loaded("a.bin", reader="pathlib:Path"), S, "reads"),
    "pixels in a plain array": (
        lambda d: (np.save(d / "a.npy", JOINTS[..., :2]), recon.load_observation(d / "a.npy")),
        F, r"\(8, 22, 2\); keypoints in pixels go into an .npz"),
    "decimal commas between commas": (
        loaded("a.csv", b"nose_x,nose_y,nose_z,neck_x,neck_y,neck_z\n" + b"1,5," * 6),
        F, "put semicolons between cells"),
    "two coordinates": (stored(positions=JOINTS[..., :2]), F, r"o\.npz.*positions"),
    "unknown names": (stored(), S, "no joint is called point 0"),
    "unknown sensor": (stored(kind="sonar"), F, "joints3d, markers3d, keypoints3d"),
    "file in millimetres": (stored(positions=1e6 * JOINTS), R, r"o\.npz"),
    "rate of 0": (stored(fps=0.0), R, r"o\.npz.*frame rate"),
    # other verbs
    "views of joints": (lambda _: recon.simulate(clip(), "joints3d", views=2), R,
                        "do not apply to joints3d"),
    "frames beyond the end": (lambda _: recon.simulate(clip(), "joints3d", frames=(0, 99)), R,
                              "expected frames within 0 to 40"),
    "ground of an estimate": (lambda _: recon.refine(clip(), "pose", ground="sea"), R,
                              "known or unknown"),
    "height of 9 m": (lambda _: recon.refine(clip(), "pose", shape="height=9"), R, "height"),
    "estimate of three frames": (lambda _: recon.refine(short(), "pose"),
                                 R, "at least 4 frames, got 3"),
    "no motions": (lambda _: recon.sample(count=0), R, "count: expected one motion or more"),
    "half a motion": (lambda _: unwrap(recon.sample)(count=1.5), R, "a whole number, got 1.5"),
    "no seconds": (lambda _: recon.sample(seconds=0.0), R, "seconds: expected a frame"),
    "body for HuMoR": (lambda _: recon.sample(shape="height=1.8"), R, "of the prior humos"),
    "continuation of a later time": (lambda _: recon.predict(clip(), at=9.0), R, "at: expected"),
    "share above 1": (lambda _: recon.interpolate(clip(), clip(), 1.5), R, "to 1 .*got 1.5"),
    "truth of other frames": (lambda _: recon.evaluate(clip(), np.zeros((3, 22, 3))), R, "truth"),
    "truth in millimetres": (
        lambda _: recon.evaluate(clip(), 1000 * np.tile(JOINTS, (5, 1, 1))), U, "truth.joints: "),
    "recording of nothing": (lambda d: recon.convert(d / "none.bvh"), FileNotFoundError,
                             r"none\.bvh: no such file"),
    "stream of no lag": (lambda _: recon.Stream(lag=-1), R, "lag: expected 0 to 120 frames"),
    "stream of cycles": (lambda _: recon.Stream("anchor"), W, "prior: expected .*'humor'"),
    "array without a template": (lambda _: recon.Stream().push(JOINTS[0]), S, "template"),
    "nobody": (lambda _: recon.fit_people([]), R, "nobody to fit"),
    "no clips": (lambda _: recon.fit_clips([]), R, "at least one clip"),
}  # fmt: skip


def clip() -> recon.Motion:
    """Forty frames of standing."""
    turns = torch.eye(3).expand(40, 22, 3, 3)
    return recon.Motion.create(torch.zeros(40, 3), turns, torch.zeros(16), fps=30.0)


def short() -> recon.Motion:
    return clip().window(0, 3)


@pytest.mark.parametrize("row", ROWS)
def test_what_is_refused_is_refused_in_words(row: str, tmp_path: Path) -> None:
    call, kind, words = ROWS[row]
    with pytest.raises(kind, match=words):
        call(tmp_path)


COMMANDS: dict[str, tuple[tuple[str, ...], str]] = {
    "no such file": (("fit", "none.npz", "--out", "m.npz"), "there is nothing at none.npz"),
    "misspelt option": (("fit", "a.npz", "--out", "b.npz", "--priro", "pose"), "--prior"),
    "misspelt verb": (("fitt", "a.npz"), "did you mean fit?"),
    "without OUT": (("fit", "a.npz"), "--out"),
    "below a file": (("sample", "--seconds", "0.1", "--out", "file/m.npz"), "which is a file"),
    "motion as folder": (("fit", "seen.npz", "--out", "."), "is a folder"),
    "motion as BVH": (("fit", "seen.npz", "--out", "m.bvh"), "make other files of it by `recon"),
    "unknown kind": (("simulate", "a.npz", "b.npz", "--kind", "sonar"), "joints3d"),
}


@pytest.mark.parametrize("row", COMMANDS)
def test_commands_refuse_in_words(row: str, seen: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place = seen.parent
    monkeypatch.chdir(place)
    monkeypatch.setenv("COLUMNS", "200")
    (place / "file").write_text("mine")
    words, said = COMMANDS[row]
    refused_by_command(*words, names=(said,))
    assert (place / "file").read_text() == "mine"

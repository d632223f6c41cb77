"""As a program: what still works while one shed after the other cannot be imported.

python -m tests.without_sheds prints a JSON object: by shed, what failed and why.
"""

import contextlib
import io
import json
import os
import sys
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import cv2  # noqa: F401 - large, and imported here once for all sheds
import numpy as np
import pygltflib  # noqa: F401
import sklearn.cluster  # noqa: F401
import torch
import trimesh  # noqa: F401
import tyro  # noqa: F401
import viser  # noqa: F401

ROOT = Path(__file__).parents[1]
SHEDS = ("live", "people", "gait", "export", "batch", "benchmark")


class Locked:
    """A finder of modules that lets nobody into a shed."""

    def __init__(self, shed: str) -> None:
        self._room = f"recon.{shed}"

    def find_spec(self, name: str, *_: object) -> None:
        """Refuse modules of the shed, and leave all others to the next finder."""
        if f"{name}.".startswith(f"{self._room}."):
            raise ModuleNotFoundError(f"{name} is locked", name=name)


def fit() -> None:
    """Fit four frames of joints."""
    import recon
    from priors.pose.prior import PosePrior
    from recon.solver.lbfgs import LBFGS

    class Quick:
        def stages(self, data):
            return tuple(replace(s, minimiser=LBFGS(2)) for s in PosePrior.load().stages(data))

    walk = recon.load_motion(ROOT / "recon" / "assets" / "demo.npz").motion.window(0, 4)
    joints = recon.BodyModel.load().pose(walk).joints.double().numpy()
    seen = recon.Joints3D(joints, np.ones((4, 22), bool), range(22), fps=walk.fps)
    assert recon.fit(seen, Quick(), repair=False).joints.shape == (4, 22, 3)


def say_help() -> None:
    """List the verbs."""
    from recon import cli

    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.suppress(SystemExit):
        cli.run(["--help"])
    assert "simulate" in said.getvalue()


def import_all(shed: str) -> None:
    """Import every module outside of the shed, other sheds included."""
    failed = []
    for package in ("recon", "priors", "observations"):
        for path in sorted((ROOT / package).rglob("*.py")):
            if path.is_relative_to(ROOT / "recon" / shed) or path.stem == "__main__":
                continue
            name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
            try:
                import_module(name.removesuffix(".__init__"))
            except ModuleNotFoundError:
                failed.append(name)
    assert not failed, f"{', '.join(failed)} import recon.{shed}"


def failures(shed: str) -> dict[str, str]:
    """What does not work without a shed, by its name."""
    sys.meta_path.insert(0, Locked(shed))
    parts: dict[str, Callable[[], None]] = {
        "fit": fit, "help": say_help, "modules": lambda: import_all(shed),
    }  # fmt: skip
    found = {}
    for part, work in parts.items():
        try:
            work()
        except Exception as error:  # whatever it is, it is told of this part
            found[part] = f"{type(error).__name__}: {error}"
    return found


def apart(shed: str) -> dict[str, str]:
    """`failures` in a process of its own, in which nothing of ours is imported yet."""
    reader, writer = os.pipe()
    if os.fork() == 0:
        with os.fdopen(writer, "w") as file:
            json.dump(failures(shed), file)
        os._exit(0)
    os.close(writer)
    with os.fdopen(reader) as file:
        said = file.read()
    os.wait()
    return json.loads(said)


if __name__ == "__main__":
    assert not any(name.partition(".")[0] in ("recon", "priors") for name in sys.modules)
    torch.set_num_threads(1)
    sys.stdout.write(json.dumps({shed: apart(shed) for shed in SHEDS}))

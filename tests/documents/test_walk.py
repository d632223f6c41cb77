"""The walk through the code names functions that a fit enters, in their order."""

import re
import sys
from collections import deque
from types import FrameType
from typing import Any

import numpy as np

import priors
import recon
from recon.core.skeleton import JOINTS
from recon.formats.observations import PositionsFile, save_observation
from tests.documents.blocks import ROOT
from tests.filmed import bundled, walk

NAMED = re.compile(r"^\d+\. `([\w/]+\.py)`: `([\w.]+)`\.", re.M)


def test_a_fit_enters_the_functions_of_the_walk_in_their_order(tmp_path):
    """A newcomer needs one path through the rooms that is true."""
    named = NAMED.findall((ROOT / "docs" / "walk.md").read_text(encoding="utf-8"))
    assert len(named) == 10
    names = {name for _, name in named}
    ahead = deque((str(ROOT / file), name) for file, name in named)

    def enter(frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        if event != "call" or code.co_qualname not in names or not ahead:
            return
        if (code.co_filename, code.co_qualname) == ahead[0]:
            ahead.popleft()

    joints = bundled().pose(walk(10)).joints.double().numpy()
    joints[6, JOINTS.index("left_knee"), 0] += 0.03
    path = tmp_path / "joints.npz"
    visible = np.ones(joints.shape[:2], dtype=bool)
    save_observation(path, PositionsFile("joints3d", joints, visible, JOINTS, 30.0))
    assert callable(recon.fit)
    assert priors.Collocation  # loaded before, as imports take long beside the profiler
    sys.setprofile(enter)
    try:
        recon.fit(path, max_seconds=1.0)
    finally:
        sys.setprofile(None)
    assert not ahead, f"not entered in this order: {ahead[0]}"

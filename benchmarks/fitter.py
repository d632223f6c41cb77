"""Version 0.1.0 as a process of its own that fits observation files as `recon fit` does.

    PYTHONPATH=/path/to/version-0.1.0 python benchmarks/fitter.py

Not imported by anything: it imports what 0.1.0 has, and `benchmarks.clouds` runs it with that
version on the path. Every line of the standard input is the JSON of a request ({"files": [...],
"out": "motion.npz", "first": "first.npz"}), every line of the standard output that of an answer.
"""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false
import json
import sys
import time
from pathlib import Path

import numpy as np
import torch
from recon.clip_files import load_clip
from recon.fit_files import fit_files
from recon.settings import FitSettings

from observations.first_guess import first_guess
from recon.body import BodyModel


def main() -> None:
    """Answer until the input ends."""
    torch.set_num_threads(1)
    body, settings = BodyModel.load(), FitSettings()
    for line in sys.stdin:
        asked = json.loads(line)
        files = [Path(name) for name in asked["files"]]
        clip = load_clip(files, settings, body)
        began = time.process_time()
        motion = first_guess(clip.observations, body).motion[0]
        first_seconds = time.process_time() - began
        place = clip.T_recording_camera
        np.savez(
            asked["first"], translation=motion.translation.numpy(), fps=motion.fps,
            rotations=motion.rotations.numpy(), shape=motion.shape.numpy(),
            T_recording_camera=np.eye(4) if place is None else place,
        )  # fmt: skip
        began = time.process_time()
        report = fit_files(files, Path(asked["out"]), settings)
        answer = {
            "first_seconds": first_seconds,
            "seconds": time.process_time() - began,
            "warnings": list(report["warnings"]),
        }
        print(json.dumps(answer, default=str), flush=True)


if __name__ == "__main__":
    main()

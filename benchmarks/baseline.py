"""Version 0.1.0 as a process of its own: fits windows, and values motions by its own objective.

    PYTHONPATH=/path/to/version-0.1.0 python benchmarks/baseline.py

Not imported by anything: it imports what 0.1.0 has, and `benchmarks.converged` runs it with that
version on the path. Every line of the standard input is the JSON of a request, every line of the
standard output that of an answer; arrays are in files (.npz).
"""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false
import json
import sys
import time
from typing import Any

import numpy as np
import torch
from priors.humor_collocation import Collocation
from recon.motion import Motion
from recon.reconstruction import fit
from recon.scene import Scene
from recon.stages import evaluate_stage
from recon.terms import Term

from observations.joints3d import Joints3D
from observations.markers3d import Markers3D
from priors.humor import Humor
from recon.body import BodyModel


def main() -> None:
    """Answer until the input ends."""
    torch.set_num_threads(1)
    body, humor = BodyModel.load(), Humor.load()
    for line in sys.stdin:
        asked = json.loads(line)
        observed = observation(asked)
        method = Collocation.for_noise(humor, asked["noise"])
        if asked["motion"] is None:
            began = time.process_time()
            result = fit([observed], method, body)
            seconds = time.process_time() - began
            motion = result.motion.detach()
            np.savez(
                asked["out"],
                translation=motion.translation.numpy(),
                rotations=motion.rotations.numpy(),
                shape=motion.shape.numpy(),
                points=observed.predict(result.estimate).detach().numpy(),
            )
            ends = [[end.name for end in r.solution.termination] for r in result.reports]
            answer = {"seconds": seconds, "ends": ends}
        else:
            answer = {"value": value(asked["motion"], observed, method, body)}
        print(json.dumps(answer), flush=True)


def observation(asked: dict[str, Any]) -> Any:
    """The windows of a request."""
    data = np.load(asked["data"])
    positions, visible = torch.from_numpy(data["positions"]), torch.from_numpy(data["visible"])
    places = tuple(data["places"].tolist())
    if asked["sensor"] == "joints":
        return Joints3D(positions=positions, visible=visible, joints=places, fps=asked["fps"])
    return Markers3D(positions=positions, visible=visible, vertices=places, fps=asked["fps"])


def value(path: str, observed: Any, method: Any, body: Any) -> list[float]:
    """The objective of the last stage at given motions."""
    data = np.load(path)
    translation, rotations, shape = (
        torch.from_numpy(data[name]) for name in ("translation", "rotations", "shape")
    )
    motion = Motion.create(translation, rotations, shape, 30.0)
    stage = method.stages((Term("data", observed, 1.0),))[-1]
    with torch.no_grad():
        scene = Scene.create(len(translation), like=translation)
        estimate = evaluate_stage(stage, body, stage.prior.encode(motion), scene)
        terms = [term.weight * term.energy(estimate) for term in stage.terms]
    return torch.stack(terms, -1).sum(-1).tolist()


if __name__ == "__main__":
    main()

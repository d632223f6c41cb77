"""A stand-in for a SMPL-X file: its array names and 55 joints, another template and shapes."""

from pathlib import Path

import numpy as np

from recon.body.model import BodyModel
from recon.core.skeleton import PARENTS

EXTRA = (15, 15, 15, *(20 for _ in range(15)), *(21 for _ in range(15)))
"""Parents of jaw, eyes and the joints of the fingers, all of which stay at rest."""


def write_smplx(path: Path, body: BodyModel, shapes: int = 16) -> Path:
    """Write it; the file is made up of our own free body, 4 % smaller, thicker, shapes mixed."""
    generator = np.random.default_rng(11)
    scale = np.array([0.98, 0.96, 1.0])
    template = body.template.numpy() * scale
    # the root of SMPL-X is at another height
    shift = np.array([0.0, -0.12, 0.01])
    template = template + shift
    mixed, _ = np.linalg.qr(generator.normal(size=(body.shape_size, body.shape_size)))
    directions = (body.shape_directions.numpy() * scale[:, None]) @ mixed[:, :shapes]
    joints = body.joint_template.numpy() * scale + shift
    joint_directions = (body.joint_directions.numpy() * scale[:, None]) @ mixed[:, :shapes]
    regressor = np.zeros((55, len(template)))
    for row in range(22):
        near = np.linalg.norm(template - joints[row], axis=1).argsort()[:400]
        known = np.concatenate(
            (template[near].T, directions[near].transpose(1, 2, 0).reshape(-1, 400),
             np.ones((1, 400)))
        )  # fmt: skip
        asked = np.concatenate((joints[row], joint_directions[row].reshape(-1), [1.0]))
        regressor[row, near] = np.linalg.lstsq(known, asked, rcond=None)[0]
    regressor[22:] = regressor[list(EXTRA)]
    weights = np.zeros((len(template), 55))
    weights[:, :22] = body.weights.numpy()
    parents = np.array([*PARENTS, *EXTRA], dtype=np.int64)
    parents[0] = 4294967295
    expressions = np.zeros((len(template), 3, 10))
    np.savez(
        path,
        v_template=template,
        # 300 shapes, then the expressions
        shapedirs=np.concatenate(
            (directions, np.zeros((len(template), 3, 300 - shapes)), expressions), axis=2
        ),
        J_regressor=regressor,
        weights=weights,
        kintree_table=np.stack((parents, np.arange(55))),
        f=body.faces.numpy(),
    )
    return path

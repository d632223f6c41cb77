"""How the body changes the motion at a fixed code, after section 5.3 of Marsot et al.

    python -m benchmarks.anchor_morphology CORPUS --weights nc --licence nc
        --json benchmarks/results/anchor_morphology_nc.json --picture docs/anchor_morphology.png

The code is that of a run: the training cycle nearest to the mean code of all that run.
`beside the kept pose` compares the cycle decoded for a body of +-3 deviations along a shape
direction with that body in the poses and places decoded for the average one: per vertex and in
mm, mean and greatest, at the same place or with pelvis on pelvis. The gradient is the forward-mode
derivative by the shape at the average body: of the decoded motion with the surface of the average
body kept (what was learned), and in total. `own body` tells whether what was learned is true:
validation cycles decoded from their codes with their own shape, with the average, and with that
of the next other person, drawn on the surface of the average body and compared with the poses
that were recorded.

Training cycles are performed by few people, and varied by moving shapes at random while paths
grow with the legs (`CycleVariation`). So dependence of places on shape is ours to a large part.
"""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from benchmarks.anchor import Cycles, asked, parser, weights_name
from benchmarks.anchor_structure import codes, learned
from benchmarks.results import corpus_source, show, write
from priors.anchor.frames import Anchors
from priors.anchor.prior import AnchorFrames
from recon.body.model import BodyModel
from recon.body.sampled import spread_vertices
from recon.core.motion import Motion
from recon.core.raster import rasterise, vertex_normals
from recon.core.skeleton import PARENTS
from recon.view.lettering import join, label, save_picture
from recon.view.scene import Figure
from recon.view.viewpoint import follow

DIRECTIONS = (0, 1)
"""Shape directions that are looked at."""
FAR = 3.0
"""Deviations."""
_SHOWN = (0, 25, 50, 75)
"""Anchors in the picture."""
_SIZE = (220, 330)


def main() -> None:
    """Measure, print, write and draw."""
    ask = asked(parser(__doc__).parse_args())
    prior = AnchorFrames.load(ask.weights)
    training = learned(Cycles.load(ask, "train", "nc", prior), ask)
    code, clip = jogging(prior, training)
    rows = {
        f"direction {k + 1}, {sign * FAR:+g}": beside_kept(prior, code, k, sign * FAR)
        for k in DIRECTIONS
        for sign in (-1.0, 1.0)
    }
    gradients = [gradient(prior, code, k) for k in DIRECTIONS]
    rates = {
        f"direction {k + 1}": rate for k, (_, rate) in zip(DIRECTIONS, gradients, strict=True)
    }
    validation = Cycles.load(ask, "validation", "nc", prior).thinned(ask.only)
    own = own_body(prior, validation)
    people = len(torch.unique(training.batch.shape, dim=0))
    for name, row in {**rows, **rates, "own body": own}.items():
        show(name, row)
    print(f"{people} bodies among {len(training.clips)} training cycles; the code is of {clip}")
    if ask.json is not None:
        write(ask.json, None, corpus_source(ask.corpus),
              weights=weights_name(ask.weights), licence=ask.licence, code=clip, bodies=people,
              kept=rows, gradient=rates, own_body=own)  # fmt: skip
    if ask.picture is not None:
        draw(ask.picture, prior, code, [vertices for vertices, _ in gradients])


def jogging(prior: AnchorFrames, training: Cycles) -> tuple[Float[Tensor, " latent"], str]:
    """The code nearest to the mean of all that run, and its clip."""
    rows = [k for k, name in enumerate(training.labels) if name == "run"]
    if len(rows) == 0:
        raise ValueError("none of the training cycles is of a run by its name")
    running = training.rows(torch.tensor(rows))
    found = codes(prior, running)
    nearest = int((found - found.mean(0)).norm(dim=-1).argmin())
    return found[nearest], running.clips[nearest]


def decoded(prior: AnchorFrames, code: Tensor, shape: Tensor) -> Anchors:
    """One cycle."""
    return Anchors.unpack(prior.weights.networks.decode(code, shape))


def far_shape(prior: AnchorFrames, direction: int, amount: float) -> Float[Tensor, " shape"]:
    """The shape that lies so many standard deviations along one direction."""
    shape = torch.zeros(prior.body.shape_size)
    shape[direction] = amount
    return shape


def beside_kept(
    prior: AnchorFrames, code: Tensor, direction: int, amount: float
) -> dict[str, float]:
    """Decoded for a body, against that body doing what the average one does."""
    shape = far_shape(prior, direction, amount)
    ours, kept = (decoded(prior, code, s) for s in (shape, torch.zeros_like(shape)))
    one, other = (prior.body.pose(x.motion(shape, 1.0)) for x in (ours, kept))
    away = (one.vertices - other.vertices).norm(dim=-1)
    centred = [p.vertices - p.joints[..., :1, :] for p in (one, other)]
    inside = (centred[0] - centred[1]).norm(dim=-1)
    return {
        "mean mm": 1000 * away.mean().item(),
        "greatest mm": 1000 * away.max().item(),
        "pelvis on pelvis, mean mm": 1000 * inside.mean().item(),
        "pelvis on pelvis, greatest mm": 1000 * inside.max().item(),
        "duration ms": 1000 * (ours.duration - kept.duration).item(),
    }


def gradient(
    prior: AnchorFrames, code: Tensor, direction: int
) -> tuple[Float[Tensor, " vertices"], dict[str, float]]:
    """Length of dD/dshape per vertex of the average body (pelvis on pelvis, mean over anchors).

    In mm per deviation; with it the means over the surface: learned, also where the pelvis goes,
    and in total.
    """
    zero = torch.zeros(prior.body.shape_size)
    step = far_shape(prior, direction, 1.0)

    def learned_part(shape: Tensor) -> tuple[Tensor, Tensor]:
        return skinned(prior.body, decoded(prior, code, shape), zero)

    def whole(shape: Tensor) -> tuple[Tensor, Tensor]:
        return skinned(prior.body, decoded(prior, code, shape), shape)

    surface, pelvis = torch.func.jvp(learned_part, (zero,), (step,))[1]
    total, _ = torch.func.jvp(whole, (zero,), (step,))[1]
    inside = 1000 * (surface - pelvis).norm(dim=-1).mean(0)
    return inside, {
        "learned, pelvis on pelvis, mm": inside.mean().item(),
        "learned, its greatest vertex, mm": inside.max().item(),
        "learned, mm": 1000 * surface.norm(dim=-1).mean().item(),
        "total, mm": 1000 * total.norm(dim=-1).mean().item(),
    }


def skinned(
    body: BodyModel, cycle: Anchors, shape: Float[Tensor, " shape"]
) -> tuple[Float[Tensor, "100 vertices 3"], Float[Tensor, "100 1 3"]]:
    """The surface and the pelvis, as `BodyModel.pose` has them.

    Made of operations that have forward-mode derivatives.
    """
    rotations, rest = cycle.full_rotations, body.rest_joints(shape)
    turns, places = [rotations[:, 0]], [rest[0].expand(len(rotations), 3)]
    for joint, parent in enumerate(PARENTS[1:], 1):
        turns.append(turns[parent] @ rotations[:, joint])
        places.append(places[parent] + turns[parent] @ (rest[joint] - rest[parent]))
    turn, place = torch.stack(turns, 1), torch.stack(places, 1) + cycle.translation[:, None]
    shift = place - (turn @ rest[..., None])[..., 0]
    unposed = body.rest_vertices(shape)
    moved = torch.einsum("vj,tjab,vb->tva", body.weights, turn, unposed)
    return moved + body.weights @ shift, place[:, :1]


@torch.no_grad()
def own_body(prior: AnchorFrames, cycles: Cycles) -> dict[str, float]:
    """Mean error in mm of recorded poses with three bodies told to the decoder."""
    truth, shape = cycles.batch.anchors, cycles.batch.shape
    found = codes(prior, cycles)
    people = torch.unique(shape, dim=0)
    who = (shape[:, None] == people).all(-1).double().argmax(1)
    told = {
        "own shape mm": shape,
        "average shape mm": torch.zeros_like(shape),
        "another's shape mm": people[(who + 1) % len(people)],
    }
    vertices = spread_vertices(prior.body, 200)

    def centred(anchors: Anchors) -> Tensor:
        posed = prior.body.pose(anchors.motion(torch.zeros_like(shape), 1.0))
        return posed.points(vertices) - posed.joints[..., :1, :]

    recorded = centred(truth)
    return {
        name: 1000 * (centred(decoded(prior, found, body)) - recorded).norm(dim=-1).mean().item()
        for name, body in told.items()
    }


def draw(path: Path, prior: AnchorFrames, code: Tensor, values: list[Tensor]) -> None:
    """A row per shape direction: the average body at some anchors, red where most moves."""
    shape = torch.zeros(prior.body.shape_size)
    with torch.no_grad():
        motion = decoded(prior, code, shape).motion(shape, 100.0)
    rows = [
        join([_picture(prior.body, motion, k, value, f"direction {row + 1}, mm per deviation: "
              f"0 to {float(value.max()):.1f}" if k == _SHOWN[0] else f"anchor {k + 1}")
              for k in _SHOWN], axis=1)
        for row, value in enumerate(values)
    ]  # fmt: skip
    save_picture(path, join(rows, axis=0))


def _picture(body: BodyModel, motion: Motion, frame: int, value: Tensor, words: str) -> np.ndarray:
    """The body in one frame, white where the value is zero, red where it is greatest."""
    figure = Figure(body, motion)
    view = follow([figure], _SIZE)[frame].scaled(2)
    vertices, faces = figure.posed.vertices[frame].double().numpy(), body.faces.numpy()
    pixels, depth = view.project(vertices)
    share = (value / value.max()).double().numpy()[:, None]
    tint = np.array([240.0, 240, 240]) * (1 - share) + np.array([200.0, 20, 20]) * share
    facing = -vertex_normals(vertices, faces) @ view.R_camera_world[2]
    lit = tint * (0.55 + 0.45 * np.clip(facing, 0, 1))[:, None]
    raster = rasterise(pixels, depth, faces, view.size, lit / 255)
    image = np.where(raster.covered[..., None], 255.0 * raster.values, 255.0)
    small = image.reshape(_SIZE[1], 2, _SIZE[0], 2, 3).mean((1, 3)).astype(np.uint8)
    label(small, words)
    return small


if __name__ == "__main__":
    main()

"""Describes the cameras of a fit for its result, with poses that the fit found or corrected."""

from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from recon.core.camera import Camera
from recon.core.motion import FilmingCamera, Motion
from recon.diagnosis.examination import ExaminedClip
from recon.fitting.records import Clip, start_times


def filming_cameras(
    examined: ExaminedClip, clip: Clip, T: Float[Tensor, "4 4"], motion: Motion
) -> tuple[FilmingCamera, ...]:
    """Return the cameras that gave 2D keypoints, with lens, clock and pose in the result's world.

    Args:
        examined: the fit.
        clip: what was fitted.
        T: maps the recording's frame to the result's world, metres.
        motion: of the result; a moving camera gets a pose for each of its frames.
    """
    late = {
        name: finding.value or 0.0
        for finding in examined.repairs
        if finding.code == "views out of step"
        for name in finding.sensors
    }
    found: list[FilmingCamera] = []
    for name, one, start in zip(
        examined.names, examined.fit.observations, start_times(clip), strict=True
    ):
        if (view := one.view) is None:
            continue
        there = view.camera.moved(T.numpy()).map(lambda tensor: tensor[0].detach().cpu())
        poses = there.T_camera_world
        if len(poses) > 1:
            frames = ((motion.times - view.start_time) * view.fps).round().long()
            poses = poses[frames.clamp(0, len(poses) - 1)]
        lens = torch.tensor(view.lens).to(poses) if view.lens else None
        camera = Camera(there.camera_matrix.reshape(-1, 3, 3)[0], there.image_size, lens, poses)
        short = Path(name).name.removesuffix(".npz")
        found.append(FilmingCamera(short, camera, start - late.get(name, 0.0)))
    return tuple(found)

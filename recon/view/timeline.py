"""Writes a show for the Rerun viewer (.rrd): meshes, joints, points and contacts.

It needs the package rerun-sdk (`pip install motion-recon[rerun]`), which is loaded when a file is
written.
"""

from pathlib import Path
from typing import Any

import numpy as np
import torch

from recon.core.errors import optional_module
from recon.core.raster import vertex_normals
from recon.core.skeleton import CONTACT_JOINTS, JOINTS, PARENTS
from recon.view.scene import (
    CERTAINTY,
    CLOUD,
    CONTACT,
    MISSING,
    VISIBLE,
    Figure,
    Points,
    Show,
    View,
)

TIME, FRAME = "time", "frame"
"""Names of the timelines: seconds of the recording's clock, and numbers of frames."""
JOINT_RADIUS_M, BONE_RADIUS_M, CONTACT_RADIUS_M, CLOUD_RADIUS_M = 0.015, 0.006, 0.055, 0.004
"""Radii of spheres and lines."""


def write_rrd(path: Path, show: Show) -> None:
    """Write figures (mesh, joints, bones, contacts), observed points and cameras over time.

    Everything is an entity of its own below `world`, which the viewer shows and hides: metres,
    z up.

    Args:
        path: file to write.
        show: what is written.

    Raises:
        ReconError: when rerun-sdk is not installed.
    """
    rerun = optional_module("rerun", "rerun-sdk", "a file for the Rerun viewer", "rerun")
    stream = rerun.RecordingStream("recon", recording_id=show.title, send_properties=False)
    stream.save(path)
    stream.log("/world", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for figure in show.figures:
        colour = (*figure.colour, round(255 * figure.opacity))
        faces = figure.body.faces.cpu().numpy()
        mesh = rerun.Mesh3D.from_fields(triangle_indices=faces, albedo_factor=colour)
        stream.log(figure.node("body"), mesh, static=True)
    times = show.figures[0].motion.times.tolist()
    for frame, time in enumerate(times):
        stream.set_time(TIME, duration=time)
        stream.set_time(FRAME, sequence=frame)
        for figure in show.figures:
            _log_figure(rerun, stream, figure, frame)
        if show.points is not None:
            _log_points(rerun, stream, show.points, frame)
        if show.cloud is not None:
            scan = rerun.Points3D(_array(show.cloud[frame]), radii=CLOUD_RADIUS_M, colors=CLOUD)
            stream.log("/world/scan", scan)
        for view in show.cameras:
            _log_camera(rerun, stream, view, frame)
    stream.flush()
    stream.disconnect()


def _array(tensor: torch.Tensor) -> np.ndarray:
    return tensor.detach().cpu().float().numpy()


def _log_figure(rerun: Any, stream: Any, figure: Figure, frame: int) -> None:
    node = figure.node
    # one frame at a time, since all meshes of a long motion would need gigabytes
    posed = figure.body.pose(figure.motion.window(frame, frame + 1).detach())
    vertices, joints = _array(posed.vertices[0]), _array(posed.joints[0])
    normals = vertex_normals(vertices, figure.body.faces.cpu().numpy())
    mesh = rerun.Mesh3D.from_fields(vertex_positions=vertices, vertex_normals=normals)
    stream.log(node("body"), mesh)
    points = rerun.Points3D(
        joints, radii=JOINT_RADIUS_M, colors=figure.colour, labels=JOINTS, show_labels=False
    )
    stream.log(node("joints"), points)
    bones = [joints[[parent, joint]] for joint, parent in enumerate(PARENTS) if parent >= 0]
    lines = rerun.LineStrips3D(bones, radii=BONE_RADIUS_M, colors=figure.colour)
    stream.log(node("bones"), lines)
    if figure.contacts is not None:
        touching = [joint for joint in CONTACT_JOINTS if bool(figure.touching[frame, joint])]
        spheres = rerun.Points3D(joints[touching], radii=CONTACT_RADIUS_M, colors=CONTACT)
        stream.log(node("contacts"), spheres)
    if figure.joint_std is not None:
        radii = _array(figure.joint_std[frame])
        spheres = rerun.Points3D(joints, radii=radii, colors=(*CERTAINTY, 90))
        stream.log(node("standard deviation"), spheres)


def _log_points(rerun: Any, stream: Any, points: Points, frame: int) -> None:
    seen = points.visible[frame].cpu().numpy()
    places = _array(points.positions[frame])[seen]
    stream.log("/world/points/seen", rerun.Points3D(places, radii=points.radius, colors=VISIBLE))
    if points.estimated is not None:
        missing = _array(points.estimated[frame])[~seen]
        hidden = rerun.Points3D(missing, radii=points.radius, colors=MISSING)
        stream.log("/world/points/hidden", hidden)


def _log_camera(rerun: Any, stream: Any, view: View, frame: int) -> None:
    camera = view.at(frame)
    pose = _array(camera.T_world_camera)
    stream.log(view.node, rerun.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
    lens = rerun.Pinhole(
        image_from_camera=_array(camera.camera_matrix), resolution=list(camera.image_size),
        image_plane_distance=0.3,
    )  # fmt: skip
    stream.log(view.node, lens)
    if view.pixels is not None:
        stream.log(
            f"{view.node}/detected", rerun.Points2D(_array(view.pixels[frame]), colors=VISIBLE)
        )

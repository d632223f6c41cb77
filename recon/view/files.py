"""`recon view`: draws motion and observation files to pages, pictures and films."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from recon.body.identities import body_weight
from recon.body.model import BodyModel
from recon.body.motion_files import load_motion_of
from recon.core.camera import Ground
from recon.core.errors import optional_module
from recon.core.motion import Motion, MotionFile
from recon.core.raster import vertex_normals
from recon.core.skeleton import CONTACT_JOINTS, JOINTS, PARENTS
from recon.formats.outputs import Output
from recon.formats.reports import checksums, versions
from recon.formats.writing import writing
from recon.view.frames import write_mp4, write_png
from recon.view.observed import read_observed
from recon.view.overlay import write_overlay, write_sheet
from recon.view.scene import (
    CERTAINTY,
    CLOUD,
    CONTACT,
    CORAL,
    GREY,
    MISSING,
    VISIBLE,
    Figure,
    Points,
    Show,
    View,
)
from recon.view.viewpoint import direction_to_the_right


def view(
    motion: Path,
    *,
    html: Path | None = None,
    png: Path | None = None,
    mp4: Path | None = None,
    rrd: Path | None = None,
    obs: tuple[Path, ...] = (),
    compare: Path | None = None,
    beside: Path | None = None,
    film: tuple[Path, ...] = (),
    frame_rate: float | None = None,
    body: Path | None = None,
    std: bool = False,
    overwrite: bool = False,
) -> None:
    """Draw a motion as a page to play, a picture or a film.

    The page is one file that needs no network. Observations from cameras add the cameras, and to
    the picture and the film what each of them sees.

    Args:
        motion: motion file.
        html: page to write.
        png: picture to write: frames side by side.
        mp4: film to write.
        rrd: file for the Rerun viewer to write, everything on a timeline; needs rerun-sdk.
        obs: observations of the motion, of any kind: their points, clouds and cameras are drawn;
            missing points where the motion has them.
        compare: a second motion, for example the truth, in the same place at the same times.
        beside: a motion to play side by side with this one, for example the same motion on
            another body; both play from their first frames on for as long as both last, with
            heights and weights in the legend.
        film: films of the motion, one for each of its cameras, told by their names or else in the
            order of the cameras: the body is drawn over them, with limbs that were not seen or
            are unsure in colours of their own. A picture has eight moments.
        frame_rate: pictures per second that the camera took, where the motion was fitted with it.
        body: the SMPL-family file of the motions' body; default: the bundled body.
        std: draw a sphere of one standard deviation around every joint. A page has these spheres
            in any case, as a layer to switch on.
        overwrite: replace files that are there and recon did not write.

    Raises:
        FileNotFoundError: when a file does not exist.
        ValueError: when one is damaged or of another body, the motions do not overlap in time, the
            standard deviations that are asked for are not known, nothing is asked for, or a film
            is not of the motion.
        FileExistsError: when a file to write is there and recon did not write it, unless
            `overwrite`.
    """
    draw_png, draw_mp4 = (write_sheet, write_overlay) if film else (write_png, write_mp4)
    every = ((mp4, draw_mp4), (html, draw_html), (png, draw_png), (rrd, write_rrd))
    asked = [(Output(path), draw) for path, draw in every if path is not None]
    if not asked:
        raise ValueError("nothing to draw: give --html, --png, --mp4 or --rrd FILE")
    show = show_of_files(
        motion, obs=obs, compare=compare, side=beside, film=film, frame_rate=frame_rate,
        body=body, certainty=std,
    )  # fmt: skip
    read = [path for path in (motion, *obs, compare, beside, *film, body) if path is not None]
    report = {"inputs": checksums(read), "versions": versions()}
    outputs = [output for output, _ in asked]
    with writing(*outputs, report=report, overwrite=overwrite) as staged:
        overlay = staged[0] if film and mp4 else None
        for path, (_, draw) in zip(staged, asked, strict=True):
            if draw is draw_html:
                draw_html(path, show, overlay)
            else:
                draw(path, show)


def show_of_files(
    motion: Path,
    *,
    obs: Sequence[Path] = (),
    compare: Path | None = None,
    side: Path | None = None,
    film: Sequence[Path] = (),
    frame_rate: float | None = None,
    body: Path | None = None,
    certainty: bool = False,
) -> Show:
    """Read motion and observation files, and make the scene that `view` draws of them.

    Raises:
        FileNotFoundError, ValueError: as `view` does.
    """
    model = BodyModel.load(body)
    file = load_motion_of(motion, model)
    if certainty and file.joint_std is None:
        raise ValueError(
            f"{motion}: no standard deviations to draw (joint_std): fits under the pose prior and "
            "HuMoR write them, other motions have none"
        )
    if frame_rate is not None and not film:
        raise ValueError("--frame-rate is that of a film over which is drawn: give --film as well")
    if film and side is not None:
        raise ValueError(
            "--beside sets a motion next to another, which has no place in a film: "
            "give --compare to draw both over it"
        )
    figures: list[Figure] = []
    if side is None:
        std, touching = file.joint_std, file.contacts
        own = Figure(model, file.motion, motion.stem, contacts=touching, joint_std=std)
        figures.append(replace(own, observed=file.observed) if film else own)
    else:
        other = load_motion_of(side, model)
        file, second = at_common_times(file, other)
        figures.append(
            _with_measures(Figure(model, file.motion, motion.stem, joint_std=file.joint_std))
        )
        aside = Figure(model, second, _second_name(side, motion), CORAL)
        figures.append(put_beside(figures[0], _with_measures(aside)))
    if compare is not None:
        other = _at_times_of_first(load_motion_of(compare, model), file.motion, compare)
        name = _second_name(compare, motion)
        figures.append(Figure(model, other, name, colour=GREY, opacity=0.45))
    points, cloud, cameras = read_observed(obs, file, model)
    if film:
        from recon.view.film import views_of_cameras, with_films  # imported only for films

        cameras = with_films(
            cameras or views_of_cameras(file.cameras), film, file.motion, str(motion), frame_rate
        )
    ground = None if file.ground is None else Ground.create(file.ground[:3], file.ground[3])
    return Show(motion.stem, tuple(figures), points, cloud, cameras, ground, certainty)


def _second_name(path: Path, first: Path) -> str:
    """Return the name of a second motion in the legend, different from that of the first."""
    return path.stem if path.stem != first.stem else f"{path.stem} (2)"


def _with_measures(figure: Figure) -> Figure:
    """Add height and weight of a figure's body to its name."""
    shape = figure.motion.shape
    tall, heavy = figure.body.height(shape), body_weight(figure.body, shape)
    return replace(figure, name=f"{figure.name}: {tall:.2f} m, {heavy:.0f} kg")


def draw_html(path: Path, show: Show, overlay: Path | None = None) -> None:
    """Write the page of a scene; its player is imported here, since it loads slowly."""
    from recon.view.html import write_html

    write_html(path, show, overlay)


def _at_times_of_first(file: MotionFile, motion: Motion, path: Path) -> Motion:
    """Resample another motion to the times of the first."""
    try:
        return file.motion.at(motion.times, motion.fps)
    except ValueError as error:
        raise ValueError(f"{path}: cannot be compared: {error}") from error


_GAP_M = 0.2
"""Gap between two bodies side by side where they come nearest, metres."""


def at_common_times(file: MotionFile, other: MotionFile) -> tuple[MotionFile, Motion]:
    """Cut two motions, from their first frames on, to the length of the shorter one.

    The other is resampled to the times of the first.
    """
    motion, second = file.motion, other.motion.replace(start_time=file.motion.start_time)
    lasts = min(m.duration for m in (motion, second))
    count = int(lasts * motion.fps + 1e-6) + 1
    motion = motion.window(0, count)
    per_frame = (
        "joints", "contacts", "contact_probability", "joint_std", "observed", "truth_visible",
        "in_camera",
    )  # fmt: skip
    known = {key: value for key in per_frame if (value := getattr(file, key)) is not None}
    cut = {key: value[:count] for key, value in known.items()}
    return replace(file, motion=motion, **cut), second.at(motion.times, motion.fps)


def put_beside(figure: Figure, other: Figure) -> Figure:
    """Move another figure to the right of the first one, so far that pictures do not overlap.

    In the first frame their pelvises are equally far from the viewer; poses stay as they are.
    """
    right = torch.from_numpy(direction_to_the_right(figure)).float()
    first, second = figure.posed.joints[..., :2], other.posed.joints[..., :2]
    level = first[0, 0] - second[0, 0]
    second = second + level
    needed = (first @ right[:2]).amax(-1) - (second @ right[:2]).amin(-1)
    shift = torch.nn.functional.pad(level, (0, 1)) + (float(needed.max()) + _GAP_M) * right
    motion = other.motion
    moved = motion.replace(translation=motion.translation + shift.to(motion.translation))
    return replace(other, motion=moved)


TIME, FRAME = "time", "frame"
"""Names of the timelines: seconds of the recording's clock, and numbers of frames."""
JOINT_RADIUS_M, BONE_RADIUS_M, CONTACT_RADIUS_M, CLOUD_RADIUS_M = 0.015, 0.006, 0.055, 0.004
"""Radii of the spheres of joints, contacts and scans, and of the lines of bones, metres."""


def write_rrd(path: Path, show: Show) -> None:
    """Write figures, observed points and cameras over time as a recording for Rerun's viewer.

    Mesh, joints, bones, contacts and the others are separate entities below `world`, which the
    viewer shows and hides; metres, z up.

    Args:
        path: file to write.
        show: the scene to write.

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
            scan = rerun.Points3D(
                _numpy_array(show.cloud[frame]), radii=CLOUD_RADIUS_M, colors=CLOUD
            )
            stream.log("/world/scan", scan)
        for view in show.cameras:
            _log_camera(rerun, stream, view, frame)
    stream.flush()
    stream.disconnect()


def _numpy_array(tensor: torch.Tensor) -> np.ndarray:
    return tensor.detach().cpu().float().numpy()


def _log_figure(rerun: Any, stream: Any, figure: Figure, frame: int) -> None:
    node = figure.node
    # one frame at a time, since all meshes of a long motion would need gigabytes
    posed = figure.body.pose(figure.motion.window(frame, frame + 1).detach())
    vertices, joints = _numpy_array(posed.vertices[0]), _numpy_array(posed.joints[0])
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
        radii = _numpy_array(figure.joint_std[frame])
        spheres = rerun.Points3D(joints, radii=radii, colors=(*CERTAINTY, 90))
        stream.log(node("standard deviation"), spheres)


def _log_points(rerun: Any, stream: Any, points: Points, frame: int) -> None:
    seen = points.visible[frame].cpu().numpy()
    places = _numpy_array(points.positions[frame])[seen]
    stream.log("/world/points/seen", rerun.Points3D(places, radii=points.radius, colors=VISIBLE))
    if points.estimated is not None:
        missing = _numpy_array(points.estimated[frame])[~seen]
        hidden = rerun.Points3D(missing, radii=points.radius, colors=MISSING)
        stream.log("/world/points/hidden", hidden)


def _log_camera(rerun: Any, stream: Any, view: View, frame: int) -> None:
    camera = view.at(frame)
    pose = _numpy_array(camera.T_world_camera)
    stream.log(view.node, rerun.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
    lens = rerun.Pinhole(
        image_from_camera=_numpy_array(camera.camera_matrix), resolution=list(camera.image_size),
        image_plane_distance=0.3,
    )  # fmt: skip
    stream.log(view.node, lens)
    if view.pixels is not None:
        stream.log(
            f"{view.node}/detected",
            rerun.Points2D(_numpy_array(view.pixels[frame]), colors=VISIBLE),
        )

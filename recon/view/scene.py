"""The scene that `html` and `frames` draw: bodies, points, contacts and cameras."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from recon.body.model import BodyModel, PosedBody
from recon.core.camera import Camera, Ground, Projection
from recon.core.motion import Motion
from recon.core.skeleton import PARENTS, joint_index
from recon.core.visible import visible

if TYPE_CHECKING:
    from recon.view.film import FilmOnClock
else:  # at run time Any replaces FilmOnClock, whose module need not be imported
    from typing import Any as FilmOnClock

Colour = tuple[int, int, int]
"""Red, green, blue, 0 to 255."""

BLUE: Colour = (116, 160, 214)
CORAL: Colour = (232, 150, 122)
GREY: Colour = (182, 186, 192)
VISIBLE: Colour = (0, 128, 98)
"""Colour of observed points, in space and in images."""
MISSING: Colour = (214, 40, 96)
"""Colour of points that were not observed, at their estimated positions."""
REPROJECTED: Colour = (38, 42, 50)
"""Colour of observed points at their estimated positions, projected into an image."""
CONTACT: Colour = (248, 160, 24)
CERTAINTY: Colour = (160, 60, 205)
"""Colour of spheres of one standard deviation around joints."""
CLOUD: Colour = (92, 98, 110)
CAMERA: Colour = (108, 88, 178)
GROUND: Colour = (188, 194, 203)
"""Colour of the grid's lines on the ground."""
INK: Colour = (38, 42, 50)
FAINT: Colour = (112, 118, 128)
WHITE: Colour = (255, 255, 255)


UNSURE = 0.3
"""Confidence below which a detected point is drawn as a ring."""


UNSURE_M = 0.1
"""Standard deviation, metres, of a joint against the surest one above which a limb is unsure."""
_TRUNK = [joint_index(name) for name in ("pelvis", "spine1", "spine2", "spine3")]
_SHOULDERS = [joint_index(f"{side}_shoulder") for side in ("left", "right")]


@dataclass(frozen=True)
class Figure:
    """A body in motion, with name, colour, contacts and standard deviations."""

    body: BodyModel
    motion: Motion
    """A single clip: no batch axis, every frame valid."""
    name: str = "reconstruction"
    """Name in the legend."""
    colour: Colour = BLUE
    opacity: float = 1.0
    """1 is solid; a reference to compare with reads well at 0.4."""
    contacts: Float[Tensor, "time 22"] | None = None
    """Probability that a joint carries weight; shown from one half on."""
    joint_std: Float[Tensor, "time 22"] | None = None
    """Standard deviation of a coordinate of every joint, metres; None where it is not known."""
    observed: Bool[Tensor, "time 22"] | None = None
    """False where a joint was inferred. Where given, limbs that were inferred, and those that are
    unsure, are drawn in colours of their own."""

    def __post_init__(self) -> None:
        motion = self.motion
        if motion.translation.ndim != 2:
            raise ValueError(
                f"figure {self.name!r} needs one clip with translation (time, 3), got "
                f"{tuple(motion.translation.shape)}; select one with motion[index]"
            )
        if motion.frames == 0 or not bool(motion.valid.all()):
            raise ValueError(
                f"figure {self.name!r} needs valid frames alone, got "
                f"{int(motion.valid.sum())} of {motion.frames}; cut the padding with window"
            )
        if not 0 < self.opacity <= 1:
            raise ValueError(f"opacity must lie in (0, 1], got {self.opacity}")
        known = {
            "contacts": self.contacts,
            "standard deviations": self.joint_std,
            "observed joints": self.observed,
        }
        for what, values in known.items():
            if values is not None and len(values) != motion.frames:
                raise ValueError(
                    f"figure {self.name!r} has {motion.frames} frames, but {len(values)} of {what}"
                )

    @cached_property
    def posed(self) -> PosedBody:
        """The body in every frame, on the CPU and free of gradients."""
        motion = self.motion.detach().to(device="cpu", dtype=torch.float32)
        return self.body.detach().to(device="cpu", dtype=torch.float32).pose(motion)

    def node(self, part: str) -> str:
        """Return the path of a part of the figure in the viewer's scene tree."""
        return f"/world/{_tree_name(self.name)}/{part}"

    @property
    def touching(self) -> Bool[Tensor, "time 22"]:
        """Mask of joints that touch the ground."""
        if self.contacts is None:
            return torch.zeros(self.motion.frames, 22, dtype=torch.bool)
        return self.contacts.detach().cpu() >= 0.5

    @cached_property
    def inferred_limbs(self) -> Bool[Tensor, "time 22"]:
        """Mask of joints whose limb was not seen from end to end; none without `observed`.

        A joint moves the limb below it. Few sensors see the spine, which counts as seen between
        hips and shoulders.
        """
        if self.observed is None:
            return torch.zeros(self.motion.frames, 22, dtype=torch.bool)
        lost = ~self.observed.detach().cpu()
        lost[:, _TRUNK] &= lost[:, _SHOULDERS].all(1, keepdim=True)
        return _limb_mask(lost)

    @cached_property
    def unsure_limbs(self) -> Bool[Tensor, "time 22"]:
        """Mask of joints whose limb was seen but has a large standard deviation."""
        if self.observed is None or self.joint_std is None:
            return torch.zeros(self.motion.frames, 22, dtype=torch.bool)
        squared = self.joint_std.detach().cpu().square()
        apart = squared - squared.amin(
            1, keepdim=True
        )  # removes the error of the body's position, which all joints share
        return _limb_mask(apart > UNSURE_M**2) & ~self.inferred_limbs


def _limb_mask(joints: Bool[Tensor, "time 22"]) -> Bool[Tensor, "time 22"]:
    """Add to a mask of joints their parents, whose limbs end there, except in the trunk."""
    limbs = joints.clone()
    for joint, parent in enumerate(PARENTS):
        if parent >= 0 and parent not in _TRUNK:
            limbs[:, parent] |= joints[:, joint]
    return limbs


@dataclass(frozen=True)
class Points:
    """Points over time: observed positions, and estimated ones where they were not seen."""

    positions: Float[Tensor, "time points 3"]
    """Observed positions in the world, metres."""
    visible: Bool[Tensor, "time points"]
    estimated: Float[Tensor, "time points 3"] | None = None
    """Positions of the points on the estimated body; without them missing points are not drawn."""
    radius: float = 0.02
    """Radius of the drawn spheres, metres."""

    def __post_init__(self) -> None:
        shapes = {tuple(self.positions.shape[:2]), tuple(self.visible.shape)}
        if self.estimated is not None:
            shapes.add(tuple(self.estimated.shape[:2]))
        if len(shapes) != 1:
            raise ValueError(
                f"points differ in their numbers of frames or points, got {sorted(shapes)}"
            )


@dataclass(frozen=True)
class View:
    """A camera of a scene, fixed or moving, perhaps with detected and reprojected points."""

    name: str
    """Name of the camera, written beside it and above its images."""
    camera: Camera
    """The camera in the world of the figures, with one pose or one per frame."""
    pixels: Float[Tensor, "time points 2"] | None = None
    """Positions of detected points in the image, pixels."""
    confidence: Float[Tensor, "time points"] | None = None
    """0 where a point was not detected, 1 where it is certain; None: all are certain."""
    reprojected: Projection | None = None
    """Projections of the points on the estimated body in this camera, (time, points)."""
    start_time: float = 0.0
    """Time of its first picture, seconds of the motion's clock."""
    film: FilmOnClock | None = None
    """The film that the camera took, which is drawn below the body; None where there is none."""

    def __post_init__(self) -> None:
        if self.camera.T_camera_world.ndim > 3 or self.camera.camera_matrix.ndim > 3:
            raise ValueError(
                f"view {self.name!r} needs one camera, with one pose or one per frame, got poses "
                f"{tuple(self.camera.T_camera_world.shape)}; select one clip"
            )
        if self.pixels is None and (self.confidence is not None or self.reprojected is not None):
            raise ValueError(
                f"view {self.name!r} has confidences or reprojected points but no pixels; give "
                "the detected points they belong to"
            )
        own = None if self.reprojected is None else self.reprojected.depth
        given = {"pixels": self.pixels, "confidence": self.confidence, "reprojected": own}
        shapes = {name: tuple(one.shape[:2]) for name, one in given.items() if one is not None}
        if len(set(shapes.values())) > 1:
            raise ValueError(
                f"view {self.name!r} has arrays of different lengths (time, points), got {shapes}"
            )
        counts = {shape[0] for shape in shapes.values()} | set(_frame_counts(self.camera))
        if len(counts) > 1:
            raise ValueError(
                f"view {self.name!r} needs as many camera poses as frames, got {sorted(counts)}"
            )

    @property
    def node(self) -> str:
        """Path of the camera in the viewer's scene tree."""
        return f"/world/cameras/{_tree_name(self.name)}"

    @property
    def frames(self) -> int | None:
        """Number of frames; None for a fixed camera without points, which fits any clip."""
        if self.pixels is not None:
            return len(self.pixels)
        return next(iter(_frame_counts(self.camera)), None)

    def at(self, frame: int) -> Camera:
        """Return the camera of one frame, in double precision."""
        camera = self.camera.detach().to(device="cpu", dtype=torch.float64)
        matrix, lens, pose = camera.camera_matrix, camera.distortion, camera.T_camera_world
        return camera.derived(
            camera_matrix=matrix[frame] if matrix.ndim == 3 else matrix,
            distortion=lens[frame] if lens is not None and lens.ndim == 2 else lens,
            T_camera_world=pose[frame] if pose.ndim == 3 else pose,
        )

    @property
    def certainty(self) -> Float[Tensor, "time points"]:
        """Confidence of the detected points, between 0 and 1."""
        if self.pixels is None:
            return torch.zeros(0, 0)
        if self.confidence is None:
            return torch.ones(self.pixels.shape[:2])
        return self.confidence.detach().cpu().clamp(0, 1).float()

    @property
    def median_error(self) -> float | None:
        """Median distance of confident detected points from reprojected ones, pixels."""
        if self.pixels is None or self.reprojected is None:
            return None
        counted = (self.certainty >= UNSURE) & self.reprojected.in_front.cpu()
        if not bool(counted.any()):
            return None
        error = (self.pixels - self.reprojected.pixels).detach().cpu().norm(dim=-1)
        return float(error[counted].median())


@dataclass(frozen=True)
class LegendLayer:
    """A layer of the scene, with its word and colour in the legend."""

    word: str
    colour: Colour
    nodes: tuple[str, ...]
    """Paths of its parts in the scene tree; a page shows and hides them together."""
    shown: bool = True
    """Whether the layer is shown at first."""


@dataclass(frozen=True)
class Show:
    """A scene over time: figures, points, cloud and cameras with common frames; z up."""

    title: str
    figures: tuple[Figure, ...]
    """Bodies to draw; the first is the subject, others are compared with it."""
    points: Points | None = None
    cloud: tuple[Float[Tensor, "_ 3"], ...] | None = None
    """Scan of every frame, world, metres; a frame may have no points."""
    cameras: tuple[View, ...] = ()
    """Cameras that filmed the scene."""
    ground: Ground | None = None
    """Ground in the world; None is z = 0."""
    certainty: bool = False
    """Whether spheres of one standard deviation are drawn around joints, where it is known. A page
    has them in any case, as a layer that can be switched on and off."""

    def __post_init__(self) -> None:
        if len(self.figures) == 0:
            raise ValueError(
                "nothing to draw: expected at least one figure (a moving body), got none"
            )
        for what, shown in (("figures", self.figures), ("cameras", self.cameras)):
            names = [one.name for one in shown]
            if len(set(names)) != len(names):
                raise ValueError(f"{what} of one scene need different names, got {names}")
        rates = {figure.motion.fps for figure in self.figures}
        if len(rates) != 1:
            raise ValueError(
                f"figures of one scene need the same frame rate, got {rates}; resample them"
            )
        counts = {figure.name: figure.motion.frames for figure in self.figures}
        if self.points is not None:
            counts["points"] = len(self.points.positions)
        if self.cloud is not None:
            counts["cloud"] = len(self.cloud)
        counts |= {view.name: view.frames for view in self.cameras if view.frames is not None}
        if len(set(counts.values())) != 1:
            raise ValueError(f"parts of a scene need the same number of frames, got {counts}")

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.figures[0].motion.frames

    @property
    def fps(self) -> float:
        """Frames per second."""
        return self.figures[0].motion.fps

    @property
    def layers(self) -> tuple[LegendLayer, ...]:
        """The layers of the scene in the order of the legend."""
        figures, points = self.figures, self.points
        found = [LegendLayer(f.name, f.colour, (f.node("body"),)) for f in figures]
        nodes = tuple(f.node("contacts") for f in figures if bool(f.touching.any()))
        found.append(LegendLayer("contact", CONTACT, nodes))
        nodes = tuple(f.node("standard deviation") for f in figures if f.joint_std is not None)
        found.append(LegendLayer("one standard deviation", CERTAINTY, nodes, shown=self.certainty))
        if points is not None:
            found.append(LegendLayer("observed point", VISIBLE, ("/world/points/observed",)))
            if points.estimated is not None and not bool(points.visible.all()):
                nodes = ("/world/points/missing",)
                found.append(LegendLayer("missing point, estimated", MISSING, nodes))
        if self.cloud is not None:
            found.append(LegendLayer("scan", CLOUD, ("/world/scan",)))
        found.append(LegendLayer("camera", CAMERA, tuple(view.node for view in self.cameras)))
        found.append(LegendLayer("ground", GROUND, ("/world/ground",)))
        return tuple(layer for layer in found if layer.nodes)

    @property
    def legend(self) -> tuple[tuple[str, Colour], ...]:
        """Label and colour of each entry of a picture's legend; the ground has no entry."""
        shown = [layer for layer in self.layers if layer.shown and layer.word != "ground"]
        entries = [(layer.word, layer.colour) for layer in shown] + list(self.limb_legend)
        if any(view.pixels is not None for view in self.cameras):
            entries.append(("detected (ring: unsure)", VISIBLE))
        fitted = [view for view in self.cameras if view.reprojected is not None]
        if fitted:
            entries.append(("same point of the body", REPROJECTED))
        if any((view.certainty == 0).any() for view in fitted):
            entries.append(("not detected, on the body", MISSING))
        return tuple(entries)

    @property
    def limb_legend(self) -> tuple[tuple[str, Colour], ...]:
        """Words and colours of limbs that were inferred or are unsure, where there are any."""
        marked = (
            ("not seen, inferred", MISSING, [one.inferred_limbs for one in self.figures]),
            (f"unsure by {UNSURE_M:g} m", CERTAINTY, [one.unsure_limbs for one in self.figures]),
        )
        return tuple((word, colour) for word, colour, any_ in marked if any(map(torch.any, any_)))


def _tree_name(name: str) -> str:
    """Convert a name to one level of the viewer's scene tree, without slashes."""
    return visible(name).replace("/", "-").strip() or "unnamed"


def nearest_samples(
    times: Float[Tensor, " frames"], observed_at: Float[Tensor, " time"]
) -> tuple[Int[Tensor, " frames"], Bool[Tensor, " frames"]]:
    """Find the sample nearest to every time, and whether it is within half a time step."""
    gap = (times[:, None].double() - observed_at[None].double()).abs()
    distance, nearest = gap.min(1)
    step = observed_at.double().diff().median() if len(observed_at) > 1 else gap.new_tensor(0)
    return nearest, distance <= 0.5 * step + 1e-6


def _frame_counts(camera: Camera) -> set[int]:
    """Return the numbers of frames of those camera tensors that have an axis of frames."""
    tensors = (camera.camera_matrix, camera.distortion, camera.T_camera_world)
    dims = (3, 2, 3)
    return {
        len(tensor)
        for tensor, dim in zip(tensors, dims, strict=True)
        if tensor is not None and tensor.ndim == dim
    }


def at_most_points(points: Float[Tensor, "points 3"], most: int) -> Float[Tensor, "some 3"]:
    """Keep every n-th point, so that at most `most` points are left."""
    return points[:: max(1, -(-len(points) // most))]

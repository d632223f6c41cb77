"""What is shown: bodies, points and contacts as values; `html` and `frames` draw them."""

import dataclasses
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.model import BodyModel, PosedBody
from recon.core.camera import Ground
from recon.core.motion import Motion
from recon.view.views import View, nearest_samples

Colour = tuple[int, int, int]
"""Red, green, blue, 0 to 255."""

BLUE: Colour = (116, 160, 214)
CORAL: Colour = (232, 150, 122)
GREY: Colour = (182, 186, 192)
VISIBLE: Colour = (0, 128, 98)
"""Observed points, in space and in images."""
MISSING: Colour = (214, 40, 96)
"""Points that were not observed, where the estimate has them."""
REPROJECTED: Colour = (38, 42, 50)
"""Observed points where the estimate has them in an image."""
CONTACT: Colour = (248, 160, 24)
CERTAINTY: Colour = (160, 60, 205)
"""Spheres of one standard deviation around joints."""
CLOUD: Colour = (92, 98, 110)
CAMERA: Colour = (108, 88, 178)
GROUND: Colour = (188, 194, 203)
"""Lines of the grid on the ground."""
INK: Colour = (38, 42, 50)
FAINT: Colour = (112, 118, 128)
WHITE: Colour = (255, 255, 255)


@dataclass(frozen=True)
class Figure:
    """One body in one motion."""

    body: BodyModel
    motion: Motion
    """A single clip: no batch axis, every frame valid."""
    name: str = "reconstruction"
    """Shown in the legend."""
    colour: Colour = BLUE
    opacity: float = 1.0
    """1 is solid; a reference to compare with reads well at 0.4."""
    contacts: Float[Tensor, "time 22"] | None = None
    """Probability that a joint carries weight; shown from one half on."""
    joint_std: Float[Tensor, "time 22"] | None = None
    """Standard deviation of a coordinate of every joint, metres; None where it is not known."""

    def __post_init__(self) -> None:
        motion = self.motion
        if motion.translation.ndim != 2:
            raise ValueError(
                f"figure {self.name!r} needs one clip with translation (time, 3), got "
                f"{tuple(motion.translation.shape)}; select one with motion[index]"
            )
        if motion.frames == 0 or not bool(motion.valid.all()):
            raise ValueError(
                f"figure {self.name!r} needs frames that all exist, "
                f"{int(motion.valid.sum())} of {motion.frames} do; cut the padding with window"
            )
        if not 0 < self.opacity <= 1:
            raise ValueError(f"opacity must lie in (0, 1], got {self.opacity}")
        if self.contacts is not None and len(self.contacts) != motion.frames:
            raise ValueError(
                f"figure {self.name!r} has {motion.frames} frames, "
                f"its contacts {len(self.contacts)}"
            )
        if self.joint_std is not None and len(self.joint_std) != motion.frames:
            raise ValueError(
                f"figure {self.name!r} has {motion.frames} frames, "
                f"its standard deviations {len(self.joint_std)}"
            )

    @cached_property
    def posed(self) -> PosedBody:
        """The body in every frame, on the CPU and free of gradients."""
        motion = self.motion.detach().to(device="cpu", dtype=torch.float32)
        return self.body.detach().to(device="cpu", dtype=torch.float32).pose(motion)

    @property
    def touching(self) -> Bool[Tensor, "time 22"]:
        """Joints that carry weight."""
        if self.contacts is None:
            return torch.zeros(self.motion.frames, 22, dtype=torch.bool)
        return self.contacts.detach().cpu() >= 0.5


@dataclass(frozen=True)
class Points:
    """Observed points; where one was not seen, the place the estimate gives it."""

    positions: Float[Tensor, "time points 3"]
    """World, metres."""
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
            raise ValueError(f"points need one (time, points) everywhere, got {sorted(shapes)}")

    def on(self, times: Float[Tensor, " frames"], observed_at: Float[Tensor, " time"]) -> "Points":
        """The points at other moments: the nearest sample, missing beyond half a sample.

        `estimated` must already be given at `times`, and is set by the caller afterwards.
        """
        if self.estimated is not None:
            raise ValueError("move points to other times before giving them an estimate")
        if len(observed_at) != len(self.positions) or len(observed_at) == 0:
            raise ValueError(
                f"{len(self.positions)} samples need as many times, got {len(observed_at)}"
            )
        nearest, close = nearest_samples(times, observed_at)
        seen = self.visible[nearest] & close[:, None]
        return dataclasses.replace(self, positions=self.positions[nearest], visible=seen)


@dataclass(frozen=True)
class Show:
    """One scene over time: z up, everything on the same frames."""

    title: str
    figures: tuple[Figure, ...]
    """The first is the subject; others are compared with it."""
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
            raise ValueError("a show needs at least one figure")
        names = [figure.name for figure in self.figures]
        if len(set(names)) != len(names):
            raise ValueError(f"figures of one show need different names, got {names}")
        views = [view.name for view in self.cameras]
        if len(set(views)) != len(views):
            raise ValueError(f"cameras of one show need different names, got {views}")
        rates = {figure.motion.fps for figure in self.figures}
        if len(rates) != 1:
            raise ValueError(f"figures of one show need one rate, got {rates}; resample them")
        counts = {figure.name: figure.motion.frames for figure in self.figures}
        if self.points is not None:
            counts["points"] = len(self.points.positions)
        if self.cloud is not None:
            counts["cloud"] = len(self.cloud)
        counts |= {view.name: view.frames for view in self.cameras if view.frames is not None}
        if len(set(counts.values())) != 1:
            raise ValueError(f"a show needs the same frames everywhere, got {counts}")

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.figures[0].motion.frames

    @property
    def fps(self) -> float:
        """Frames per second."""
        return self.figures[0].motion.fps

    @property
    def legend(self) -> tuple[tuple[str, Colour], ...]:
        """Words for the colours that occur."""
        entries = [(figure.name, figure.colour) for figure in self.figures]
        if any(bool(figure.touching.any()) for figure in self.figures):
            entries.append(("contact", CONTACT))
        if self.certainty and any(figure.joint_std is not None for figure in self.figures):
            entries.append(("one standard deviation", CERTAINTY))
        if self.points is not None:
            entries.append(("observed point", VISIBLE))
            if self.points.estimated is not None and not bool(self.points.visible.all()):
                entries.append(("missing point, estimated", MISSING))
        if self.cloud is not None:
            entries.append(("scan", CLOUD))
        if self.cameras:
            entries.append(("camera", CAMERA))
        return tuple(entries)

    @property
    def image_legend(self) -> tuple[tuple[str, Colour], ...]:
        """Words for the colours that occur in the images of the cameras."""
        entries = [(figure.name, figure.colour) for figure in self.figures]
        if any(view.pixels is not None for view in self.cameras):
            entries.append(("detected (ring: unsure)", VISIBLE))
        fitted = [view for view in self.cameras if view.reprojected is not None]
        if fitted:
            entries.append(("same point of the body", REPROJECTED))
        if any(view.missing.any() for view in fitted):
            entries.append(("not detected, on the body", MISSING))
        return tuple(entries)

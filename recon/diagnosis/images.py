"""Keypoints and cameras of one clip as NumPy arrays, which the checks of 2D data use."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from observations.keypoints2d import Keypoints2D
from observations.noise import estimate_noise, weights_of
from observations.start.images import pixels_per_metre
from recon.body.model import BodyModel
from recon.core.struct import concatenate
from recon.diagnosis.findings import stretches
from recon.diagnosis.quick_fit import middle_seconds, quick_stages
from recon.fitting.stages import for_one_view
from recon.method.pace import PACE, paced
from recon.method.reconstruction import solve
from recon.method.stages import Stage
from recon.method.terms import Term

_SCALE_MEDIAN_S = 0.5
"""Time (s) before and after each frame over which the median of the image scale is taken."""


@dataclass(frozen=True)
class Images:
    """2D keypoints and cameras of all views that share a clock and a set of keypoints."""

    pixels: Float[np.ndarray, "views moments points 2"]
    """Image positions of the keypoints (pixels), without lens distortion."""
    confidence: Float[np.ndarray, "views moments points"]
    """Confidence of the detector per keypoint; 0 where it is not seen."""
    matrix: Float[np.ndarray, "views 3 3"]
    """Camera matrices (pixels)."""
    pose: Float[np.ndarray, "views moments 4 4"]
    """T_camera_world of every view in every frame (metres)."""
    scale: Float[np.ndarray, "views moments"]
    """Pixels per metre at the body, from the least foreshortened bones."""
    size: tuple[tuple[int, int], ...]
    """Width and height of every image, pixels."""
    names: tuple[str, ...]
    """Names of the views."""
    points: tuple[str, ...]
    """Names of the keypoints."""
    fps: float
    fixed: tuple[bool, ...]
    """Whether each camera has one pose for all frames."""
    rest: Float[np.ndarray, "points 3"]
    """Positions of the keypoints on the average body in its rest pose, metres."""
    views: tuple[Keypoints2D, ...]
    """The observations from which the arrays were made."""
    body: BodyModel
    """Body model on which the keypoints are defined."""

    @classmethod
    def of(cls, views: Sequence[Keypoints2D], names: Sequence[str], body: BodyModel) -> "Images":
        """Build the arrays from the views of one clip, whose batch axis has length one."""
        moments, points = views[0].pixels.shape[-3], views[0].points.names
        average = body.joint_template.new_zeros(body.shape_size)
        rest = views[0].points.at_rest(body, average).double().numpy()
        pixels = np.stack([view.pixels[0].double().numpy() for view in views])
        confidence = np.stack([view.confidence[0].double().numpy() for view in views])
        poses = [view.camera.T_camera_world[0].double().numpy() for view in views]
        each = zip(pixels, confidence, strict=True)
        return cls(
            pixels=pixels,
            confidence=confidence,
            matrix=np.stack(
                [v.camera.camera_matrix[0].reshape(-1, 3, 3)[0].double() for v in views]
            ),
            pose=np.stack([np.broadcast_to(one, (moments, 4, 4)) for one in poses]),
            scale=np.stack([_pixels_per_metre(*own, points, rest, views[0].fps) for own in each]),
            size=tuple(view.camera.image_size for view in views),
            names=tuple(names),
            points=points,
            fps=views[0].fps,
            fixed=tuple(view.camera.T_camera_world.shape[-3] == 1 for view in views),
            rest=rest,
            views=tuple(views),
            body=body,
        )

    @property
    def sensors(self) -> list[Keypoints2D]:
        """The views as sensors again, with the keypoints and camera poses of these arrays.

        Views of which nothing changed are the very same objects.
        """
        return [self._sensor_of_view(v, view) for v, view in enumerate(self.views)]

    def _sensor_of_view(self, v: int, view: Keypoints2D) -> Keypoints2D:
        pixels = torch.from_numpy(self.pixels[v]).to(view.pixels)[None]
        confidence = torch.from_numpy(self.confidence[v]).to(view.confidence)[None]
        if not (torch.equal(pixels, view.pixels) and torch.equal(confidence, view.confidence)):
            view = view.replace(pixels=pixels, confidence=confidence)
        pose = self.pose[v, :1] if self.fixed[v] else self.pose[v]
        poses = torch.from_numpy(pose).to(view.camera.T_camera_world)[None]
        if not torch.equal(poses, view.camera.T_camera_world):
            view = view.replace(camera=view.camera.replace(T_camera_world=poses))
        return view

    @property
    def seen(self) -> Bool[np.ndarray, "views moments points"]:
        """Mask of the keypoints that a detector found."""
        return self.confidence > 0

    @property
    def shown(self) -> Float[np.ndarray, "views moments points 2"]:
        """Pixels of the keypoints; NaN where a keypoint was not found."""
        return np.where(self.seen[..., None], self.pixels, np.nan)

    @property
    def noise(self) -> Float[np.ndarray, " views"]:
        """Standard deviation of a pixel coordinate in every view; infinite if unknown."""
        pixels, seen = torch.from_numpy(self.pixels), torch.from_numpy(self.seen)
        each = zip(pixels, seen, strict=True)
        return np.array([estimate_noise(*view, (0.0, np.inf)) for view in each])

    @cached_property
    def counterparts(self) -> Int[np.ndarray, " points"]:
        """Index of every keypoint's left-right counterpart; its own index if it has none."""
        sides = {"left": "right", "right": "left"}
        parts = [name.partition("_") for name in self.points]
        others = ["".join((sides.get(side, side), *rest)) for side, *rest in parts]
        return np.array([self.points.index(name) for name in others])

    @cached_property
    def sided(self) -> Bool[np.ndarray, " points"]:
        """Mask of the keypoints that have a counterpart on the other side of the body."""
        return self.counterparts != np.arange(len(self.points))

    @property
    def focal(self) -> Float[np.ndarray, " views"]:
        """Mean focal length of each view (pixels)."""
        return self.matrix[:, [0, 1], [0, 1]].mean(-1)

    def view(self, rows: Sequence[int]) -> "Images":
        """Return the images of some of the views."""
        index = list(rows)
        return replace(
            self,
            pixels=self.pixels[index],
            confidence=self.confidence[index],
            matrix=self.matrix[index],
            pose=self.pose[index],
            scale=self.scale[index],
            size=tuple(self.size[v] for v in index),
            names=tuple(self.names[v] for v in index),
            fixed=tuple(self.fixed[v] for v in index),
            views=tuple(self.views[v] for v in index),
        )

    def exchanged(
        self,
        flags: Bool[np.ndarray, "views moments"],
        order: Int[np.ndarray, " points"] | None = None,
    ) -> "Images":
        """Return images with keypoints' names permuted in some views and frames.

        Args:
            flags: views and frames in which names are permuted.
            order: keypoint k gets the position of keypoint order[k]; default: left-right exchange.
        """
        in_frames = flags[..., None]
        order = self.counterparts if order is None else order
        return replace(
            self,
            pixels=np.where(in_frames[..., None], self.pixels[:, :, order], self.pixels),
            confidence=np.where(in_frames, self.confidence[:, :, order], self.confidence),
        )

    def without(self, hidden: Bool[np.ndarray, "views moments points"]) -> "Images":
        """Return images without some keypoints; the scale is estimated again from the others."""
        pixels = np.where(hidden[..., None], 0.0, self.pixels)
        confidence = np.where(hidden, 0.0, self.confidence)
        scale = self.scale.copy()
        for v in np.flatnonzero(hidden.any((1, 2)) & (confidence > 0).any((1, 2))):
            scale[v] = _pixels_per_metre(
                pixels[v], confidence[v], self.points, self.rest, self.fps
            )
        return replace(self, pixels=pixels, confidence=confidence, scale=scale)


def _pixels_per_metre(
    pixels: Float[np.ndarray, "moments points 2"],
    confidence: Float[np.ndarray, "moments points"],
    points: Sequence[str],
    rest: Float[np.ndarray, "points 3"],
    fps: float,
) -> Float[np.ndarray, " moments"]:
    """Estimate pixels per metre at the body, as the median over a second around each frame."""
    place, found, at_rest = (torch.from_numpy(a) for a in (pixels, confidence, rest))
    scale = pixels_per_metre(points, at_rest, place[None], found[None])[0].numpy()
    reach = min(round(_SCALE_MEDIAN_S * fps), len(scale) - 1)
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(scale, reach, "edge"), 2 * reach + 1)
    return np.median(windows, -1)


_AROUND_CHANGE_S = 0.5
"""Time (s) before and after a change of names that quick fits cover."""
_QUICK_PACE = 15.0
"""Frame rate (Hz) of the first of two fits that must agree."""
_MAX_COST_RATIO = 0.8
"""Ratio to which undoing a change of names must reduce the objective of a quick fit. For true
changes of training people it is 0.7 at most; if right names are changed, 1.4 at least."""
_MIN_FACING_SHARE = 0.95
"""Share of the frames in which a person who never turns faces the same side of the image."""


def confirmed_sides(
    images: Images, flags: Bool[np.ndarray, " moments"]
) -> Bool[np.ndarray, " moments"]:
    """Return a mask of the frames of one view where quick fits confirm a left-right exchange.

    A stretch that begins or ends with the clip has only one change of names, and the part before
    or after it may be the wrong one: then the body must also face the same side of the image
    throughout.
    """
    changes = np.flatnonzero(np.diff(flags)) + 1
    after = images.exchanged(flags[None])
    better = dict(zip(changes.tolist(), undoing_improves_fit(images, after, changes), strict=True))
    sure = np.zeros_like(flags)
    for a, b in stretches(flags):
        ends = [better[t] for t in (a, b + 1) if t in better]
        sure[a : b + 1] = all(ends) and (len(ends) == 2 or keeps_facing_one_side(after))
    return sure


def undoing_improves_fit(
    images: Images, repaired: Images, changes: Int[np.ndarray, " changes"]
) -> Bool[np.ndarray, " changes"]:
    """For each change of names in one view, return whether undoing it improves a quick fit.

    Args:
        images: images with the changes of names.
        repaired: the same images without them.
        changes: first frame after each change.
    """
    moments = images.confidence.shape[1]
    half = min(round(_AROUND_CHANGE_S * images.fps), moments // 2)
    first = np.clip(changes - half, 0, moments - 2 * half).tolist()
    versions = [
        view.derived(**view.fields_at(range(a, a + 2 * half)))
        for view in (*images.sensors, *repaired.sensors)
        for a in first
    ]
    given, new = _costs_of_quick_fits(versions, images.body).reshape(2, -1)
    return new < _MAX_COST_RATIO * given


def fits_better_exchanged(images: Images, share: float) -> bool:
    """Whether a body fits one view clearly better with all names of left and right exchanged.

    Knees, feet and the face tell the front from the back, and so the sides. The exchange must
    reduce the objective below `share` of its value, in fits at `_QUICK_PACE` and then at up to
    60 Hz: a single fit may end in a wrong local minimum under the right names.
    """
    after = images.exchanged(np.ones(images.confidence.shape[:2], dtype=bool))
    excerpts = [middle_seconds(one.sensors[0]) for one in (images, after)]
    costs = (
        _costs_of_quick_fits([paced(one, rate) for one in excerpts], images.body)
        for rate in (_QUICK_PACE, PACE)
    )
    return all(exchanged < share * given for given, exchanged in costs)


def keeps_facing_one_side(images: Images) -> bool:
    """Whether the body faces the same side of the only view's image in nearly all frames."""
    seen = images.seen[0] & images.seen[0][:, images.counterparts]
    names = ("shoulder", "hip")
    pairs = [k for k, name in enumerate(images.points) if name in {f"left_{n}" for n in names}]
    across = images.pixels[0] - images.pixels[0][:, images.counterparts]
    across = np.where(seen[..., None], across, 0.0)[:, pairs].sum(1)
    return bool((across @ across.mean(0) > 0)[seen[:, pairs].any(-1)].mean() > _MIN_FACING_SHARE)


def _costs_of_quick_fits(
    versions: Sequence[Keypoints2D], body: BodyModel
) -> Float[np.ndarray, " versions"]:
    """Return objectives (m²) of quick fits to equally long versions of one camera's keypoints."""
    seen = concatenate(list(versions))
    start = seen.start(body)
    noise = seen.noise(start, body)

    def stages(data: tuple[Term, ...]) -> tuple[Stage[Any], ...]:
        return for_one_view(quick_stages(noise.metres, data))

    found = solve([seen], stages, body, start=start, weights=weights_of((noise,)))
    return found.reports[-1].solution.value.double().numpy()


_MAX_LENGTH_RATIO = 1.1
"""Largest plausible ratio of a bone's length in an image to its length at the body's size."""


def limb_root_by_keypoint_pair(images: Images) -> dict[tuple[int, int], int]:
    """Map every pair (elbow, wrist) to its shoulder, and every pair (knee, ankle) to its hip."""
    chains = [
        [f"{side}_{part}" for part in limb]
        for side in ("left", "right")
        for limb in (("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle"))
    ]
    rows = [[*map(images.points.index, chain)] for chain in chains if {*chain} <= {*images.points}]
    return {(middle, end): root for root, middle, end in rows}


def bone_length_saved(
    images: Images, view: int, pair: tuple[int, int]
) -> Float[np.ndarray, " moments"]:
    """Return by how many metres exchanging two keypoints shortens bones that are too long.

    NaN where not the whole limb is seen; zero for keypoints that are no neighbours on a limb.
    """
    root = limb_root_by_keypoint_pair(images).get(pair)
    if root is None:
        return np.zeros(images.pixels.shape[1])
    there = images.seen[view][:, [root, *pair]].all(-1)
    length = _MAX_LENGTH_RATIO * np.linalg.norm(images.rest[root] - images.rest[pair[0]])
    ways = images.pixels[view, :, [root]] - images.pixels[view, :, list(pair)]
    excess = (np.linalg.norm(ways, axis=-1) / images.scale[view] - length).clip(min=0.0)
    return np.where(there, excess[0] - excess[1], np.nan)

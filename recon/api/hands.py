"""Fits finger joints to observed hand keypoints, after the body was fitted."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from observations.noise import estimate_noise
from recon.body.hands import WRISTS, HandModel
from recon.body.model import BodyModel
from recon.core.fingers import HAND_JOINTS, ROWS, SIDES, Hands
from recon.core.motion import Motion
from recon.diagnosis.findings import Finding, Findings
from recon.fitting.hands import FittedHand, HandView, fit_hand
from recon.method.sensor import Sensor

_POINTS, _FEWEST = 21, 6
"""Points of a hand, and how many must be seen in a frame where any is, in the median."""
_ELSEWHERE = 0.2
"""Metres from the body's wrist from which on a hand is another's."""
_NEARER = 0.02
"""Metres by which a hand is nearer to the other wrist where it was taken for that of the other."""
_STRAIGHT = 0.01
"""Metres that fingertips are on one side of the palm, in the mean, where that tells the hand."""
_NOISE_M, _NOISE_PX, _FRAMES = (0.002, 0.05, 0.004), (0.5, 20.0, 3.0), 8
"""Least, largest and usual standard deviations of a coordinate, metres and pixels, and frames from
which on the data tell it."""
_SURE = 0.03
"""Metres, the standard deviation of a fingertip from which on it is said to be a guess."""
_ONE_VIEW = 2.0
"""Factor of standard deviations of fingertips from one view, near which bends may be mistaken for
others: nine tenths of the errors are below 1.645 of them in the twenty poses (of the tests'
`poses.csv`) that it was chosen for, 85 % in the twenty others."""
_SAME_TIME = 0.02
"""Distance of a time from a sensor's frame, in frames, up to which it is that frame's time."""
_KNUCKLES, _TIPS = [5, 9, 13, 17], [8, 12, 16, 20]


@dataclass(frozen=True)
class _SeenHands:
    """Keypoints of both hands from one sensor (left 21, right 21), at the motion's frames."""

    values: Float[Tensor, "time 42 dims"]
    confidence: Float[Tensor, "time 42"]
    camera: Any
    noise: float

    def view(self, hand: int) -> HandView:
        part = slice(_POINTS * hand, _POINTS * (hand + 1))
        return HandView(self.values[:, part], self.confidence[:, part] / self.noise, self.camera)


def with_fingers(
    motion: Motion,
    body: BodyModel,
    observations: Sequence[Sensor],
    fitted_observations: Sequence[Sensor],
    T_world_recording: Float[Tensor, "4 4"],
) -> tuple[Motion, Findings]:
    """Fit both hands; return the motion with finger rotations, and findings about the hands.

    Only wrists turn, so that all joints of the body stay where they are.

    Args:
        motion: of the body, one clip without a batch axis.
        body: whose motion it is.
        observations: all of the clip, with one leading axis.
        fitted_observations: the same in this order as fitted, with the cameras that were found.
        T_world_recording: from the frame of the observations to that of the motion, metres.
    """
    seen = [
        _hands_at_frames(motion, body, one, fitted, T_world_recording.double())
        for one, fitted in zip(observations, fitted_observations, strict=True)
        if getattr(one, "fingers", None) is not None
    ]
    posed = body.pose(motion)
    places = posed.joints[:, list(WRISTS)].double()
    turns = posed.orientations[:, list(WRISTS)].double()
    seen, repairs = _views_with_hands_swapped_back(seen, places)
    chosen, found = _observed_hand_of_each_wrist(seen, places)
    found = Findings(repairs, ()) + found
    model = HandModel.of(body, motion.shape)
    rotations = torch.eye(3).repeat(motion.frames, len(HAND_JOINTS), 1, 1).to(motion.rotations)
    lengths = torch.zeros(len(HAND_JOINTS) + 10).to(motion.rotations)
    lengths[ROWS] = model.lengths.to(lengths)
    local, unsure = motion.rotations.clone(), []
    for side, hand in enumerate(chosen):
        views = [] if hand is None else [one.view(hand) for one in seen]
        views = [one for one in views if bool((one.weights > 0).any())]
        if not views:  # nothing is seen, so the fit gives the rest pose
            none = torch.zeros(motion.frames, _POINTS, 3).double()
            views = [HandView(none, none[..., 0])]
        fit = fit_hand(views, model, side, turns[:, side], places[:, side], motion.fps)
        joints = ROWS[side].unflatten(0, (5, 4))[:, :3].flatten()
        rotations[:, joints] = fit.local.to(rotations)
        lengths[ROWS[side]] = fit.lengths.to(lengths)
        if hand is not None:
            wrist = WRISTS[side]
            elbow = posed.orientations[:, wrist - 2].double()
            local[:, wrist] = (elbow.mT @ fit.wrist).to(local)
            unsure += _uncertainty_findings(fit, views, SIDES[side])
    if chosen == [None, None]:
        return motion, found
    return (
        motion.replace(rotations=local, hands=Hands(rotations, lengths)),
        found + Findings((), (), tuple(unsure)),
    )


def _hands_at_frames(
    motion: Motion,
    body: BodyModel,
    sensor: Any,
    fitted_sensor: Any,
    T_world_recording: Float[Tensor, "4 4"],
) -> _SeenHands:
    """Return one sensor's hand keypoints at the times of the motion's frames.

    Between two frames of the sensor, points are interpolated if both show them; those of a moving
    camera are taken from the nearest frame. Points that are relative to the body are moved to
    where the body is.
    """
    moving = sensor.view is not None and fitted_sensor.camera.T_camera_world.shape[1] > 1
    frames, share = _neighbouring_frames(motion.times, fitted_sensor, nearest=moving)
    there = ((frames >= 0) & (frames < sensor.moments)).all(0)
    frames, share = frames.clamp(0, sensor.moments - 1), share[..., None, None]
    points = sensor.fingers[0].double().cpu()
    rows = points[frames]
    confidence, camera = rows[..., -1].amin(0) * there[:, None], None
    values = (share * rows[..., :-1]).sum(0)
    if sensor.view is None:
        noise = _hand_noise(points, _NOISE_M)
        turn, away = T_world_recording[:3, :3], T_world_recording[:3, 3]
        values = values @ turn.mT + away
        if not sensor.placed:
            own = (share * sensor.positions[0, frames].double()).sum(0) @ turn.mT + away
            counts = sensor.visible[0, frames].all(0).double()[..., None]
            offset = (sensor.predict(body.pose(motion)).double() - own) * counts
            values = values + offset.sum(1, keepdim=True) / counts.sum(1, keepdim=True).clamp(1)
    else:
        noise = _hand_noise(points, _NOISE_PX)
        camera = fitted_sensor.camera.moved(T_world_recording.numpy()).map(
            lambda x: x[0].double().cpu()
        )
        if camera.T_camera_world.shape[0] > 1:
            camera = camera.at(frames[0])
    return _SeenHands(values * (confidence > 0)[..., None], confidence, camera, noise)


def _neighbouring_frames(
    times: Float[Tensor, " time"], sensor: Any, *, nearest: bool
) -> tuple[Int[Tensor, "2 time"], Float[Tensor, "2 time"]]:
    """Return the sensor's frames before and after each time, and weights to interpolate them.

    With `nearest`, or at the time of a frame, both are the nearest frame.
    """
    position = (times - sensor.start_time) * sensor.fps
    whole = position.round()
    at_frame = (position - whole).abs() < (torch.inf if nearest else _SAME_TIME)
    before = torch.where(at_frame, whole, position.floor())
    share = torch.where(at_frame, 0.0, position - before)
    frames = torch.stack((before, before + ~at_frame)).long()
    return frames, torch.stack((1 - share, share))


def _hand_noise(points: Float[Tensor, "moments 42 numbers"], limits: tuple[float, ...]) -> float:
    """Estimate the noise of hand keypoints; return a default if there are too few frames."""
    least, most, usual = limits
    if len(points) < _FRAMES:
        return usual
    return estimate_noise(points[None, ..., :-1], points[None, ..., -1] > 0, (least, most))


def _observed_hand_of_each_wrist(
    seen: Sequence[_SeenHands], places: Float[Tensor, "time 2 3"]
) -> tuple[list[int | None], Findings]:
    """Return which observed hand (0, 1) belongs to the left and right wrist; None to skip it.

    Points in space say where a hand is, and by the side of the palm to which its fingers bend
    whether it is a left or a right one.
    """
    chosen: list[int | None] = [0, 1]
    warnings: list[Finding] = []

    def leave_out(hand: int, why: str) -> None:
        chosen[hand] = None
        said = f"{SIDES[hand]} hand: {why}; its fingers are left at rest"
        warnings.append(Finding("hand", said, (f"{SIDES[hand]}_wrist",)))

    for hand in (0, 1):
        counts = torch.cat([(one.view(hand).weights > 0).sum(-1) for one in seen])
        counts = counts[counts > 0].double()
        if len(counts) == 0:
            chosen[hand] = None
        elif float(counts.median()) < _FEWEST:
            leave_out(
                hand, f"fewer than {_FEWEST} of its {_POINTS} points are seen in most frames"
            )
    spatial = [one for one in seen if one.camera is None]
    views = [one for one in seen if one.camera is not None]
    spatial += [_triangulated(views)] if len(views) > 1 else []
    away = [[_wrist_distance(seen, hand, places[:, side]) for side in (0, 1)] for hand in (0, 1)]
    sides = [_side_shown_by_bending(spatial, hand) for hand in (0, 1)]
    there = [hand for hand in (0, 1) if chosen[hand] is not None]
    other = {hand: away[hand][1 - hand] < away[hand][hand] - _NEARER for hand in there}
    if there and all(
        sides[hand] in (None, 1 - hand) and (other[hand] or sides[hand] == 1 - hand)
        and away[hand][1 - hand] < _ELSEWHERE for hand in there
    ):  # fmt: skip
        said = (
            "the points of the left and the right hand are exchanged: each lies at the other "
            "wrist or bends as the other hand does; they were exchanged back"
        )
        repair = Finding("sides exchanged", said)
        return [chosen[1], chosen[0]], Findings((repair,), tuple(warnings))
    for hand in there:
        if (far := away[hand][hand]) > _ELSEWHERE:
            leave_out(hand, f"its points are {far:.2f} m from the wrist of the body")
        elif sides[hand] == 1 - hand:
            leave_out(hand, "fingers bend to its back, so it is mirrored or the other hand")
    return chosen, Findings((), tuple(warnings))


def _views_with_hands_swapped_back(
    seen: Sequence[_SeenHands], places: Float[Tensor, "time 2 3"]
) -> tuple[list[_SeenHands], tuple[Finding, ...]]:
    """Return all views, with left and right hand swapped where each lies at the other wrist."""
    out, numbers = list(seen), []
    for k, one in enumerate(seen):
        away = [
            [_wrist_distance([one], hand, places[:, side]) for side in (0, 1)] for hand in (0, 1)
        ]
        there = [bool((one.view(hand).weights > 0).any()) for hand in (0, 1)]
        if one.camera is None or not all(there):
            continue
        if all(
            away[hand][1 - hand] < min(away[hand][hand] - _NEARER, _ELSEWHERE) for hand in (0, 1)
        ):
            both = [*range(_POINTS, 2 * _POINTS), *range(_POINTS)]
            values, confidence = one.values[:, both], one.confidence[:, both]
            out[k] = replace(one, values=values, confidence=confidence)
            numbers.append(str(k))
    if not numbers:
        return out, ()
    said = (
        f"the points of the left and the right hand are exchanged in view {', '.join(numbers)}: "
        "each lies at the other wrist; they were exchanged back"
    )
    return out, (Finding("sides exchanged", said),)


def _triangulated(views: Sequence[_SeenHands]) -> _SeenHands:
    """Triangulate the hand keypoints that at least two views see; world coordinates, metres."""
    from recon.reading.tracks import nearest_to_rays

    rays, poses = [], []
    for one in views:
        matrix, pose = one.camera.camera_matrix, one.camera.T_camera_world
        local = torch.nn.functional.pad(one.values, (0, 1), value=1.0) @ matrix.inverse().mT
        rays.append(local[..., :2].numpy())
        poses.append(pose[:, None, :3].expand(len(one.values), 1, 3, 4).numpy())
    seen = torch.stack([one.confidence > 0 for one in views])
    points = torch.from_numpy(nearest_to_rays(np.stack(rays), np.stack(poses), seen.numpy()))
    met = (seen.sum(0) > 1).double()
    return _SeenHands(points * met[..., None], met, None, _NOISE_M[2])


def _wrist_distance(
    seen: Sequence[_SeenHands], hand: int, wrist_positions: Float[Tensor, "time 3"]
) -> float:
    """Return the median distance of an observed hand from a wrist of the body, metres.

    In an image it is the distance across the line of sight, at the depth of the wrist.
    """
    found = []
    for one in seen:
        view = one.view(hand)
        shown = (view.weights > 0).double()
        wrist = shown[:, :1].bool()
        shown = torch.where(wrist, torch.nn.functional.pad(shown[:, :1], (0, 20)), shown)
        middle = (shown[..., None] * view.values).sum(1) / shown.sum(1, keepdim=True).clamp(min=1)
        if one.camera is None:
            away = (middle - wrist_positions).norm(dim=-1)
        else:
            seen_at = one.camera.project(wrist_positions[:, None])
            focal = one.camera.camera_matrix[..., [0, 1], [0, 1]].mean(-1)
            pixels = (middle - seen_at.pixels[:, 0]).norm(dim=-1)
            away = pixels * seen_at.depth[:, 0].abs() / focal
        found.append(away[shown.any(1)])
    every = torch.cat(found) if found else torch.zeros(0)
    return float(every.median()) if len(every) > 0 else 0.0


def _side_shown_by_bending(seen: Sequence[_SeenHands], hand: int) -> int | None:
    """Tell a left (0) from a right hand (1) by how its fingers bend; None if they are straight."""
    found = []
    for one in seen:
        view = one.view(hand)
        palm = view.values[:, [0, 5, 17]]
        back = torch.linalg.cross(palm[:, 1] - palm[:, 0], palm[:, 2] - palm[:, 0], dim=-1)
        back = back / back.norm(dim=-1, keepdim=True).clamp(min=1e-9)
        step = view.values[:, _TIPS] - view.values[:, _KNUCKLES]
        rise = (step * back[:, None]).sum(-1)
        shown = (view.weights > 0)[:, [0, 5, 17]].all(1)[:, None]
        found.append(rise[shown & (view.weights[:, _TIPS] > 0) & (view.weights[:, _KNUCKLES] > 0)])
    every = torch.cat(found) if found else torch.zeros(0)
    if len(every) == 0 or abs(float(every.mean())) < _STRAIGHT:
        return None
    return 0 if float(every.mean()) < 0 else 1


def _uncertainty_findings(fit: FittedHand, views: Sequence[HandView], side: str) -> list[Finding]:
    """Return a finding if the positions of the fingertips are uncertain, else an empty list."""
    std = float(fit.tip_std.median())
    alone = len(views) == 1 and views[0].camera is not None
    std *= _ONE_VIEW if alone else 1.0
    if not alone and std < _SURE:
        return []
    why = "few of its points are seen"
    if alone:
        why = "one view says little of depth, and other bends of fingers may look the same"
    said = f"fingertips are known to about {1e3 * std:.0f} mm (standard deviation): {why}"
    return [Finding("hand", f"{side} hand: {said}", (f"{side}_wrist",), value=std)]

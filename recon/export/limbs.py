"""Moves legs and arms of a character so that they keep a person's ground contacts."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from recon.body.contacts import MAXIMUM_SPEED
from recon.body.model import BodyModel
from recon.core import rotations as so3
from recon.core.arrays import runs_of_true
from recon.core.fingers import SIDES
from recon.core.motion import Motion
from recon.core.skeleton import joint_index
from recon.export.rig import CharacterRig, Posed

LEG, ARM = ("hip", "knee", "ankle"), ("shoulder", "elbow", "wrist")
_REACH = 0.9995
"""Greatest distance from a limb's start to its end, as a share of the length of its bones."""
_NEAR = 0.04
"""Height above the ground, metres, up to which a foot or hand counts as touching it."""
_LOW = 0.25
"""Range of heights above `_NEAR`, metres, over which the person's foot loses its influence."""
_SOFT = 0.002
"""Scale of the soft minimum of heights, metres, that weights the lowest points."""
_LEAVING = 3 * MAXIMUM_SPEED
"""Speed, m/s, below which a foot near the ground is landing, standing or leaving."""
_EASE = 0.25
"""Time, seconds, in which a hand moves to its contact, and hips are raised or lowered."""
_BENT = 0.02
"""Weight of the thigh's front in the direction to which a knee bends, per length of the leg."""


@dataclass(frozen=True)
class Contacts:
    """Height, displacement and ground contact of a person's foot or hand, in every frame."""

    height: Float[Tensor, " time"]
    """Height of its lowest point above the ground, metres."""
    steps: Float[Tensor, "time 2"]
    """Horizontal displacement of that point since the frame before, metres; zero at first."""
    stands: Bool[Tensor, " time"]
    """Whether the foot or hand touches the ground and is slow."""

    @classmethod
    def of(cls, points: Float[Tensor, "time points 3"], fps: float) -> "Contacts":
        """Find the contacts of a foot's or hand's skin points with the ground z = 0."""
        height = points[..., 2].amin(1)
        steps = torch.nn.functional.pad(
            steps_of_lowest_point(points, points[..., 2]), (0, 0, 1, 0)
        )
        speed = steps.norm(dim=-1) * fps
        near = (height < _NEAR) & (speed < _LEAVING)
        return cls(height, steps[:, :2], _runs_with_slow_frame(near, speed < MAXIMUM_SPEED))


@dataclass(frozen=True)
class PersonMotion:
    """Hips, leg length and contacts of the person whom a character follows; z up, metres."""

    middle: Float[Tensor, "time 3"]
    """Midpoint of the hip joints."""
    leg: float
    """Length of the straight leg, from the hip joint to the sole."""
    contacts: dict[str, Contacts]
    """Contacts of feet, keyed by ankle, and of hands, keyed by wrist."""

    @classmethod
    def of(cls, motion: Motion, body: BodyModel, ground: float) -> "PersonMotion":
        """Compute a person's hips, leg length and contacts from a motion on level ground."""
        posed, rest = body.pose(motion), body.rest_joints(motion.shape)
        sole = body.rest_vertices(motion.shape)[:, 1].min()
        own, contacts = body.weights.argmax(-1), {}
        for side in SIDES:
            for end, joints in (("ankle", ("ankle", "foot")), ("wrist", ("wrist",))):
                rows = torch.tensor([joint_index(f"{side}_{joint}") for joint in joints])
                points = posed.points(torch.isin(own, rows).nonzero()[:, 0])
                shift = points.new_tensor([0.0, 0.0, ground])
                contacts[f"{side}_{end}"] = Contacts.of(points - shift, motion.fps)
        chain = rest[[joint_index(f"left_{joint}") for joint in LEG]]
        length = chain.diff(dim=0).norm(dim=-1).sum() + chain[-1, 1] - sole
        hips = [joint_index(f"{side}_hip") for side in SIDES]
        return cls(posed.joints[:, hips].mean(1), float(length), contacts)


@dataclass(frozen=True)
class Limb:
    """A leg or an arm of a character, with the person's contacts that it keeps."""

    rig: CharacterRig
    chain: tuple[int, ...]
    """Nodes of hip, knee and ankle, or of shoulder, elbow and wrist."""
    tip: tuple[int, ...]
    """Animated nodes of the foot, or of the forearm and the hand."""
    contacts: Contacts
    is_arm: bool

    @classmethod
    def of(
        cls, rig: CharacterRig, side: str, names: tuple[str, ...], person: PersonMotion
    ) -> "Limb":
        """Make a leg or arm of the rig, with the person's contacts that it has to keep."""
        nodes, tree = rig.character.bones.nodes, rig.character.tree
        chain = tuple(nodes[f"{side}_{name}"] for name in names)
        # an arm's tip is all from the elbow on: the forearm can be lower than a hand on the ground
        end = chain[1 if names == ARM else 2]
        tip = tuple(k for k in rig.rest if end in tree.path_to_root(k))
        return cls(rig, chain, tip, person.contacts[f"{side}_{names[2]}"], names == ARM)

    @property
    def length(self) -> float:
        """Length of its two bones together, in the scene."""
        places = torch.from_numpy(self.rig.character.rest_positions)[list(self.chain)]
        return float(places.diff(dim=0).norm(dim=-1).sum())

    def end_targets(self, posed: Posed, fps: float, ratio: float, ground: float) -> Tensor:
        """Return target positions of the limb's end joint in the scene, (time, 3).

        While the person's foot stands, the character's lowest point moves as the person's does,
        times `ratio` where that is below 1; between stances the offsets that this takes are
        blended. Near the ground, and for a hand around its contacts, its height is the person's
        times `ratio`; it is never below the ground.
        """
        end, stands = posed[self.chain[2]][:, :3, 3], self.contacts.stands
        away = self._end_points(posed) - end[:, None]
        depth = away[..., 1].amin(1)
        steps = self.contacts.steps * min(ratio, 1.0)
        # x and y of the person are x and -z of the scene
        steps = torch.stack((steps[:, 0], -steps[:, 1]), -1)
        moves = end.diff(dim=0) + steps_of_lowest_point(away, away[..., 1])
        shift = _shifts_while_standing(steps[1:] - moves[:, [0, 2]], stands, fps, self.is_arm)
        high = ground + ratio * self.contacts.height.clamp(min=0.0) - depth - end[:, 1]
        near = upper_envelope(stands.double(), fps)
        if not self.is_arm:
            near = near.maximum(1 - _smooth_step((self.contacts.height - _NEAR) / _LOW))
        high = (high * near).maximum((ground - depth - end[:, 1]).clamp(min=0.0))
        return end + torch.stack((shift[:, 0], high, shift[:, 1]), -1)

    def _end_points(self, posed: Posed) -> Float[Tensor, "time points 3"]:
        """Return skin points of foot or hand; points below joints if the skin is unreadable."""
        points = self.rig.points(posed, list(self.tip))
        if points.shape[1]:
            return points
        character, found = self.rig.character, []
        low = character.lowest_height
        for node in self.tip:
            depth = 0.0 if low is None or self.is_arm else character.rest_positions[node, 1] - low
            turn = posed[node][:, :3, :3] @ self.rig.rest[node].mT
            found.append(posed[node][:, :3, 3] - float(depth) * turn[..., 1])
        return torch.stack(found, 1)

    def sink_needed(self, posed: Posed, goal: Float[Tensor, "time 3"]) -> Float[Tensor, " time"]:
        """Return how far the hips must sink for the limb to reach its goal, in every frame."""
        joints = torch.stack([posed[k][:, :3, 3] for k in self.chain], 1)
        length = _REACH * joints.diff(dim=1).norm(dim=-1).sum(1)
        way = joints[:, 0] - goal
        level = way[:, [0, 2]].square().sum(-1)
        return (way[:, 1] - (length.square() - level).clamp(min=0.0).sqrt()).clamp(min=0.0)

    def rotations_reaching(
        self, posed: Posed, goal: Float[Tensor, "time 3"]
    ) -> dict[int, Float[Tensor, "time 3 3"]]:
        """Return world rotations of both bones that move the end to a goal, or as near as it gets.

        The middle joint stays on its side of the line between the ends; the knee of a straight
        leg bends to the front of the thigh.
        """
        top, middle, last = (posed[k][:, :3, 3] for k in self.chain)
        a, b = (middle - top).norm(dim=-1), (last - middle).norm(dim=-1)
        way, was = goal - top, _unit_vectors(last - top)
        far = way.norm(dim=-1).clamp(max=_REACH * (a + b)).maximum((a - b).abs() / _REACH)
        way = _unit_vectors(way)
        side = middle - top
        if not self.is_arm:
            turn = posed[self.chain[0]][:, :3, :3] @ self.rig.rest[self.chain[0]].mT
            side = side + _BENT * (a + b)[:, None] * turn[..., 2]
        side = _unit_vectors(side - (side * was).sum(-1, keepdim=True) * was)
        side = (so3.rotation_between(was, way) @ side[..., None])[..., 0]
        along = (a.square() + far.square() - b.square()) / (2 * far)
        out = (a.square() - along.square()).clamp(min=0.0).sqrt()
        bend = top + along[:, None] * way + out[:, None] * side
        first = so3.rotation_between(middle - top, bend - top)
        second = so3.rotation_between(last - middle, top + far[:, None] * way - bend)
        return {self.chain[0]: first, self.chain[1]: second}


def steps_of_lowest_point(
    points: Float[Tensor, "time points 3"], heights: Float[Tensor, "time points"]
) -> Float[Tensor, "steps 3"]:
    """Return the lowest point's displacement between frames, a mean over points of like height."""
    share = torch.softmax((heights.amin(1, keepdim=True) - heights) / _SOFT, 1)
    between = 0.5 * (share[1:] + share[:-1])
    return (between[..., None] * points.diff(dim=0)).sum(1)


def upper_envelope(values: Float[Tensor, " time"], fps: float) -> Float[Tensor, " time"]:
    """Return a smooth curve that is nowhere below `values`, and zero far from non-zero values."""
    reach = max(1, round(_EASE / 2 * fps))
    rows = values[None, None]
    high = torch.nn.functional.max_pool1d(
        torch.nn.functional.pad(rows, (2 * reach, 2 * reach), mode="replicate"), 2 * reach + 1, 1
    )
    return torch.nn.functional.avg_pool1d(high, 2 * reach + 1, 1)[0, 0]


def _unit_vectors(vectors: Float[Tensor, "time 3"]) -> Float[Tensor, "time 3"]:
    return vectors / vectors.norm(dim=-1, keepdim=True).clamp(min=1e-9)


def _runs_with_slow_frame(
    near: Bool[Tensor, " time"], slow: Bool[Tensor, " time"]
) -> Bool[Tensor, " time"]:
    """Keep the runs of true `near` in which `slow` is true at least once."""
    kept = torch.zeros_like(near)
    for first, stop in runs_of_true(near.numpy()):
        kept[first:stop] = bool(slow[first:stop].any())
    return kept


def _shifts_while_standing(
    steps: Float[Tensor, "steps 2"], stands: Bool[Tensor, " time"], fps: float, blends: bool
) -> Float[Tensor, "time 2"]:
    """Return horizontal offsets of a foot that change by `steps` per frame while it stands.

    Their mean over every stance is zero. Between stances they are blended from one to the next;
    with `blends` they go to zero there.
    """
    found, frames = steps.new_zeros(len(stands), 2), len(stands)
    stretches = runs_of_true(stands.numpy())
    for first, stop in stretches:
        path = torch.nn.functional.pad(steps[first : stop - 1], (0, 0, 1, 0)).cumsum(0)
        found[first:stop] = path - path.mean(0)
    edges = [0, *(edge for stretch in stretches for edge in stretch), frames]
    for first, stop in zip(edges[::2], edges[1::2], strict=True):
        before = found[first - 1] if first else found.new_zeros(2)
        after = found[stop] if stop < frames else found.new_zeros(2)
        count = torch.arange(1, stop - first + 1, dtype=steps.dtype)[:, None]
        if blends:
            ease = max(1.0, _EASE * fps)
            fall, rise = _smooth_step(1 - count / ease), _smooth_step(1 - count.flip(0) / ease)
        else:
            # before the first stance and after the last one, the offset of that stance is kept
            rise = _smooth_step(count / (stop - first + 1)) if first else torch.ones_like(count)
            rise = rise if stop < frames else torch.zeros_like(count)
            fall = 1 - rise
        found[first:stop] = before * fall + after * rise
    return found


def _smooth_step(share: Tensor) -> Tensor:
    """Return the smooth step 3 s² - 2 s³ of a share clamped to [0, 1], level at both ends."""
    share = share.clamp(0.0, 1.0)
    return share * share * (3 - 2 * share)

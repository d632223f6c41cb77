"""Clips from all their observations: first guess, weights, ground, then the method."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from observations import kinds
from observations.camera_paths import with_unit
from observations.first_guess import FirstGuess, first_guess, labelled
from observations.keypoints2d import OFFSET_UNIT
from observations.noise import weights_of
from observations.timing import at_observation_times
from priors.checkpoints import FIRST
from recon.body.model import BodyModel
from recon.core.errors import ObservationError
from recon.core.motion import Motion
from recon.core.residuals import Noise
from recon.core.scene import GROUND, HEIGHT, LENS, OFFSETS, Scene, UnknownGround, UnknownLens
from recon.core.skeleton import joint_index
from recon.core.struct import concatenate
from recon.fitting.ground import ground_below, pelvis_path, sole_heights, upright_ground
from recon.fitting.long import WINDOW, OneShape, fit_long
from recon.fitting.methods import FitOptions, WithoutRoot, WithScene, WithSizeHeld, method_of
from recon.method.protocols import Sensor
from recon.method.reconstruction import Method, Reconstruction, solve
from recon.method.shape_prior import WithShape
from recon.method.stages import Compared, Watch
from recon.method.start import checked_start
from recon.method.terms import Term, ground_moved, lens_changed, offsets

_BALLS = tuple(joint_index(f"{side}_foot") for side in ("left", "right"))
LONG = 10.0
"""Seconds; longer recordings are fitted by windows."""
_MOST = 1.5
"""Factor by which sizes may be wrong at first; beyond it, camera and ground contradict."""
KEYPOINT_OFFSET_DEVIATION = 0.005
"""Metres by which a detector's idea of a joint differs between people, as one frame would tell it.
It differs by a centimetre or two, but frames repeat each other."""
GROUND_DEVIATION = 0.001
"""Metres and radians by which a plane that is given or seen may miss the ground: thousands of
points see it, and no step of a person should outweigh them."""
LENS_DEVIATION = 0.3
"""Standard deviation of the logarithm of a focal length that is guessed from the image size."""
ROUGH = FitOptions(prior=FIRST)


@dataclass(frozen=True)
class ClipFit:
    """What came out, and what was assumed."""

    result: Reconstruction
    """The fit in the world, where z = 0 is the ground."""
    noises: tuple[Noise, ...]
    ground_known: bool
    T_world_recording: Float[Tensor, "clips 4 4"]
    """Maps the frame of the observations to the world; metres."""
    observations: tuple[Sensor, ...]
    """The observations as they were compared, with the rows of their offsets."""
    grounded: bool = True
    """Whether there is a ground at all; without one, the world is the frame of the observations
    and its z = 0 means nothing."""
    ground_seen: bool = False
    """Whether an unknown ground was laid on a plane that is given or seen."""
    guesses: Compared | None = None
    """The first guesses among which a quick fit chose; None where there was one only."""

    @property
    def compared(self) -> tuple[Compared, ...]:
        """All hypotheses that were compared on the way, the last ones last."""
        stages = [report.compared for report in self.result.reports]
        return tuple(one for one in (self.guesses, *stages) if one is not None)

    @property
    def lens_found(self) -> bool:
        """Whether the focal length of the camera was found with the motion."""
        return self.result.estimate.scene.lens is not None


def fit_clip(
    observations: Sequence[Sensor],
    options: FitOptions,
    body: BodyModel,
    watch: Watch | None = None,
    start: Motion | None = None,
) -> ClipFit:
    """Fit observations that share a frame, the recording's; with a leading axis of clips.

    Clips of one batch are taken to be equally noisy; only one at a time may be long.

    Where the ground is not known, the pose prior alone finds a first motion, the way people stand
    a first ground, and the method moves both further. Recordings longer than `LONG` keep the
    ground that their first seconds tell. Without any ground (`options.grounded`) the method
    alone is fitted, in the frame of the observations.

    Args:
        observations: of the clips.
        options: how to fit.
        body: whose motion it is.
        watch: told about every iteration.
        start: a first guess in the frame of the observations, axes (clips, time), instead of what
            the data tell.

    Raises:
        ValueError: when some observations know the ground and others do not, or the start does
            not fit the observations.
    """
    known = {observation.ground_known for observation in observations}
    if len(known) > 1 and kinds.views(observations):
        raise ObservationError(
            "some observations know where the ground is and some do not: give every camera its "
            "pose (T_camera_world), or none"
        )
    if start is None:
        observations = labelled(observations)
    guess = _first_guess(observations, body, start, options)
    noises = tuple(
        one.noise(guess.motion, body, options.noise_of(row))
        for row, one in enumerate(observations)
    )
    seen, offsets = _with_offsets(tuple(observations))
    job = _Job(seen, guess, noises, offsets, body, options, watch).decided()
    if not options.grounded:
        job = job.paced()
        start = job.guess.motion
        T = torch.eye(4).expand(len(start.translation), 4, 4)
        result = job.fit(options, job.scene(start), start, job.moved)
        seen = job.settled(result)
        return ClipFit(result, noises, False, T, seen, grounded=False, guesses=job.guesses)
    if known == {True}:
        start = guess.motion if guess.distance_known else job.on_known_ground()
        T = torch.eye(4).expand(len(start.translation), 4, 4)
        result = job.fit(options, job.scene(start), start, job.moved)
        return ClipFit(result, noises, True, T, seen, guesses=job.guesses)
    job = job.paced()
    result = job.with_ground()
    assert result.estimate.scene.ground is not None
    T = result.estimate.scene.ground.T_world_recording.detach().cpu()
    shown, seen = job.ground_seen, job.settled(result)
    return ClipFit(result, noises, False, T, seen, ground_seen=shown, guesses=job.guesses)


def _with_offsets(observations: tuple[Sensor, ...]) -> tuple[tuple[Sensor, ...], int]:
    """Several views of one layout tell where this person's keypoints are; and how many rows."""
    views = kinds.views(observations)
    if len(views) < 2 or len({o.points.names for o in views}) > 1:
        return observations, 0
    count = len(views[0].points.names)
    rows = (0, count)
    return tuple(
        o.derived(offset_rows=rows) if kinds.views([o]) else o for o in observations
    ), count


def _first_guess(
    observations: Sequence[Sensor], body: BodyModel, start: Motion | None, options: FitOptions
) -> FirstGuess:
    """The caller's start, or what the data tell; of the shape that is known, if one is."""
    if start is None:
        guess = first_guess(observations, body)
    else:
        guess = FirstGuess(checked_start(start, tuple(observations), body), True)
    known = options.shape
    if known is None and options.shape_prior is not None:
        known = options.shape_prior.mean
    if known is None:
        return guess
    shape = known.to(guess.motion.shape).expand_as(guess.motion.shape)
    return FirstGuess(
        guess.motion.replace(shape=shape),
        guess.distance_known,
        tuple(other.replace(shape=shape) for other in guess.others),
    )


@dataclass(frozen=True)
class _Job:
    """What stays the same while a clip is fitted more than once."""

    observations: tuple[Sensor, ...]
    guess: FirstGuess
    noises: tuple[Noise, ...]
    offsets: int
    """Rows of `Scene.offsets`."""
    body: BodyModel
    options: FitOptions
    watch: Watch | None
    guesses: Compared | None = None
    """The first guesses that the one was chosen from."""

    @property
    def long(self) -> bool:
        motion = self.guess.motion
        return (motion.frames - 1) / motion.fps > LONG

    @property
    def moved(self) -> frozenset[str]:
        """What of the scene is found besides the motion, the ground aside."""
        found = OFFSETS if self.offsets else frozenset()
        return found | LENS if self.lens_unknown else found

    @property
    def lens_unknown(self) -> bool:
        """Whether one view of unknown pose is all there is, and its focal length is a guess."""
        # the path of a camera that moves is of the lens that its tracker had
        return self.size_untold and not kinds.views(self.observations)[0].focal_known

    @property
    def one_view(self) -> bool:
        """Whether one view is all there is: only standing feet tell how large the person is."""
        return len(self.observations) == len(kinds.views(self.observations)) == 1

    @property
    def size_untold(self) -> bool:
        """Whether one view of a camera that stands at an unknown place is all there is."""
        if not self.one_view:
            return False
        (view,) = kinds.views(self.observations)
        return not view.ground_known and view.camera.T_camera_world.shape[-3] == 1

    def scene(self, start: Motion, ground: UnknownGround | None = None) -> Scene:
        """A scene with no offsets of keypoints, and a ground."""
        clips = len(start.translation)
        scene = Scene.create(clips, self.offsets, like=start.translation)
        if not self.lens_unknown:
            return scene.replace(ground=ground)
        pelvis = self.body.pose(start).joints[..., :1, :].mean(-3, keepdim=True)
        depth = kinds.views(self.observations)[0].camera.to_camera(pelvis)[..., 2].flatten(1)
        return scene.replace(ground=ground, lens=UnknownLens.create(depth[:, 0]))

    @property
    def rough(self) -> FitOptions:
        """The pose prior alone, which does not ask where the ground is, for first motions."""
        known = self.options
        return replace(ROUGH, shape=known.shape, shape_prior=known.shape_prior)

    def method(self, options: FitOptions, moved: frozenset[str]) -> Method:
        noise = min(noise.metres for noise in self.noises)
        method = method_of(options, noise, self.body)
        if options.shape is not None:
            method = OneShape(method)
        elif options.shape_prior is not None:
            method = WithShape(method, options.shape_prior.terms(self.body, noise))
        elif self.one_view:
            method = WithSizeHeld(method)
        terms = options.terms
        if moved >= OFFSETS:
            weight = (noise * OFFSET_UNIT / KEYPOINT_OFFSET_DEVIATION) ** 2
            terms = (*terms, Term("offsets", offsets, weight))
        if moved >= LENS:
            terms = (*terms, Term("lens", lens_changed, (noise / LENS_DEVIATION) ** 2))
        if moved >= GROUND and self.ground_seen:
            terms = (*terms, Term("ground", ground_moved, (noise / GROUND_DEVIATION) ** 2))
        method = WithScene(method, moved, terms) if moved or terms else method
        return method if self.guess.distance_known else WithoutRoot(method)

    def fit(
        self, options: FitOptions, scene: Scene, start: Motion, moved: frozenset[str]
    ) -> Reconstruction:
        """The whole clip, from a start, moving some of the scene.

        Long clips find the scene in their first seconds and keep it.
        """
        run = partial(fit_long if self.long else solve, body=self.body)
        if self.long and moved:
            first = self.first_seconds()
            shorter = start.window(0, first.guess.motion.frames)
            scene, moved = first.fit(options, scene, shorter, moved).estimate.scene, frozenset()
        return run(
            self.observations,
            self.method(options, moved),
            scene=scene,
            start=start,
            weights=weights_of(self.noises),
            watch=self.watch,
        )

    def decided(self) -> "_Job":
        """The clips with the likeliest of their first guesses.

        Which it is, a quick fit under the pose prior tells: half the moments, few of the points,
        and of a long recording its first seconds.
        """
        if not self.guess.others:
            return self
        shown = self.first_seconds() if self.long else self
        rough = tuple(
            o.coarse(self.body) if not o.point_names(self.body) else o for o in shown.observations
        )
        starts = [one.resample(one.fps / 2) for one in (shown.guess.motion, *shown.guess.others)]
        found = solve(
            rough,
            self.method(self.rough, frozenset()),
            self.body,
            start=starts[0],
            others=starts[1:],
            scene=self.scene(starts[0]),
            weights=weights_of(self.noises),
            watch=self.watch,
        )
        every = (self.guess.motion, *self.guess.others)
        rows = [every[number][[row]] for row, number in enumerate(found.chosen or ())]
        guess = FirstGuess(concatenate(rows), self.guess.distance_known)
        return replace(self, guess=guess, guesses=found.reports[-1].compared)

    def on_known_ground(self) -> Motion:
        """A first motion under the pose prior, as far from the one camera as its soles are low.

        What a camera sees does not change when everything is farther and larger by one factor.
        """
        free = self.free()
        view = kinds.views(self.observations)[0]
        eye = view.camera.T_world_camera[..., :3, 3].mean(-2)
        factor = eye[:, 2] / (eye[:, 2] - sole_heights(free, self.body))
        factor = torch.where((factor > 1 / _MOST) & (factor < _MOST), factor, 1.0)
        pelvis = self.body.rest_joints(free.shape)[:, 0]
        place = free.translation + (pelvis - eye)[:, None]
        return free.replace(translation=place * factor[:, None, None] - (pelvis - eye)[:, None])

    @property
    def ground_seen(self) -> bool:
        """Whether the recording's z = 0 was laid on a plane that is given or seen."""
        seen = any(cloud.ground_seen for cloud in kinds.clouds(self.observations))
        return seen or self.options.ground_given

    def settled(self, result: Reconstruction) -> tuple[Sensor, ...]:
        """The observations with what was found of the scene."""
        scene = result.estimate.scene.detach()
        return tuple(
            views[0].settled(scene) if (views := kinds.views([one])) else one
            for one in self.observations
        )

    def free(self) -> Motion:
        """A first motion under the pose prior, which does not ask where the ground is."""
        start = self.guess.motion
        return self.fit(self.rough, self.scene(start), start, frozenset()).motion

    def paced(self) -> "_Job":
        """The clips with the unit of the camera's path told by the feet of a first motion."""
        views = kinds.views(self.observations)
        if len(self.observations) > 1 or not views or views[0].unit_known:
            return self
        (view,) = views
        motion = self.free()
        feet = self.body.pose(motion).joints[..., list(_BALLS), :]
        there, _ = at_observation_times(
            feet, motion, fps=view.fps, start_time=view.start_time, moments=view.moments
        )
        if there.shape[-3] < view.moments:
            return self
        seen = view.camera.to_camera(there).detach().double().cpu().numpy()
        found = with_unit(view, seen)
        moved = found.camera.T_world_camera[..., :3, 3] - view.camera.T_world_camera[..., :3, 3]
        if motion.frames == view.moments:
            motion = motion.replace(translation=motion.translation + moved)
        return replace(self, observations=(found,), guess=replace(self.guess, motion=motion))

    def with_ground(self) -> Reconstruction:
        """The whole clip and its ground, found from the way people stand."""
        start = self.guess.motion
        level = all(one.level for one in self.observations)
        if level:  # the recording's z is up, only heights are not known
            start, unknown = self.free(), HEIGHT
            ground = ground_below(start, self.body)
        elif self.ground_seen:
            ground, unknown = UnknownGround.create(pelvis_path(start, self.body)), GROUND
        else:
            start, unknown = self.free(), GROUND
            ground = upright_ground(start, self.body)
        if not self.options.knows_gravity:
            unknown = frozenset()
        return self.fit(self.options, self.scene(start, ground), start, self.moved | unknown)

    def first_seconds(self) -> "_Job":
        """The clip cut off after a window's length."""
        begin = self.guess.motion.start_time
        frames = round(WINDOW * self.guess.motion.fps) + 1  # the window has both its ends
        seen = tuple(o.window(begin, begin + WINDOW) for o in self.observations)
        guess = FirstGuess(
            self.guess.motion.window(0, frames),
            self.guess.distance_known,
            tuple(other.window(0, frames) for other in self.guess.others),
        )
        return replace(self, observations=seen, guess=guess)

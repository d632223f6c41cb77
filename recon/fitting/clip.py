"""The fit of a clip: first guess, weights, unknown ground and lens, then the prior's stages."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from observations.first_guess import FirstGuess, guessed
from observations.noise import weights_of
from observations.points import OFFSET_UNIT
from priors.checkpoints import FIRST
from recon.body.model import BodyModel
from recon.body.soles import sole_heights
from recon.core.motion import Motion
from recon.core.residuals import Noise
from recon.core.scene import GROUND, HEIGHT, LENS, OFFSETS, Scene, UnknownGround, UnknownLens
from recon.core.skeleton import joint_index
from recon.fitting.methods import FitOptions
from recon.fitting.records import ClipFit
from recon.fitting.stages import (
    after_placement,
    keeping_distance,
    prior_stages,
    shape_found_once,
    shape_held,
    with_relative_accelerations,
    with_scene,
    with_shape_terms,
    without_root,
)
from recon.method.reconstruction import Reconstruction, solve
from recon.method.sensor import Sensor, frame_is_level, views_of
from recon.method.stages import Stage, Stages, Watch
from recon.method.terms import Term, ground_moved, lens_changed, offsets

_BALLS = tuple(joint_index(f"{side}_foot") for side in ("left", "right"))
LONG = 10.0
"""Seconds; longer recordings are fitted by windows."""
_MOST = 1.5
"""Factor by which sizes may be wrong at first; beyond it, camera and ground contradict."""
KEYPOINT_OFFSET_DEVIATION = 0.005
"""Standard deviation between people of where a detector places a joint, metres, for one frame.
The true one is 1 to 2 cm; it is smaller here as errors of neighbouring frames are correlated."""
GROUND_DEVIATION = 0.001
"""Metres and radians by which a plane that is given or seen may miss the ground: thousands of
points see it, and no step of a person should outweigh them."""
LENS_DEVIATION = 0.3
"""Standard deviation of the logarithm of a focal length that is guessed from the image size."""
ROUGH = FitOptions(prior=FIRST)


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
    ground found in their first seconds. Without any ground (`options.grounded`) the method
    alone is fitted, in the frame of the observations.

    Args:
        observations: of the clips.
        options: how to fit.
        body: whose motion it is.
        watch: called after every iteration.
        start: a first guess in the frame of the observations, axes (clips, time), instead of what
            a guess from the data.

    Raises:
        ValueError: when some observations know the ground and others do not, or the start does
            not fit the observations.
    """
    seen, guess = guessed(observations, body, start, options.starting_shape)
    return posed(seen, guess, options, body, watch).solved()


def posed(
    observations: tuple[Sensor, ...],
    guess: FirstGuess,
    options: FitOptions,
    body: BodyModel,
    watch: Watch | None = None,
) -> "ClipProblem":
    """The problem to minimise: observations weighted by their noise, and the first motion."""
    noises = tuple(
        one.noise(guess.motion, body, options.noise_of(row))
        for row, one in enumerate(observations)
    )
    seen, offsets = _with_keypoint_offsets(observations)
    return ClipProblem(seen, guess, noises, offsets, body, options, watch)


def _with_keypoint_offsets(observations: tuple[Sensor, ...]) -> tuple[tuple[Sensor, ...], int]:
    """The observations with unknown keypoint offsets, which several views of one layout determine.

    And their number of rows.
    """
    views = views_of(observations)
    if len(views) < 2 or len({o.points.names for o in views}) > 1:
        return observations, 0
    count = len(views[0].points.names)
    rows = (0, count)
    return tuple(o.derived(offset_rows=rows) if o.view else o for o in observations), count


@dataclass(frozen=True)
class ClipProblem:
    """A clip's observations, noise, first guess and options, for one or several fits."""

    observations: tuple[Sensor, ...]
    guess: FirstGuess
    noises: tuple[Noise, ...]
    offsets: int
    """Rows of `Scene.offsets`."""
    body: BodyModel
    options: FitOptions
    watch: Watch | None

    def solved(self) -> ClipFit:
        """The motion, and the ground where it is not known."""
        if not self.options.grounded:
            return self.with_camera_scale()._solved_in_recording(ground_known=False)
        if all(one.ground_known for one in self.observations):
            return self._solved_in_recording(ground_known=True)
        job = self.with_camera_scale()
        result = job.with_ground()
        assert result.estimate.scene.ground is not None
        T = result.estimate.scene.ground.T_world_recording.detach()
        return job._clip_fit(result, T, ground_known=False)

    def _solved_in_recording(self, *, ground_known: bool) -> ClipFit:
        """The motion in the frame of the recording, which is the world or has no ground."""
        start = self.guess.motion
        if ground_known and not self.guess.distance_known:
            start = self.on_known_ground()
        result = self.fit(self.options, self.scene(start), start, self.moved)
        T = torch.eye(4).expand(len(start.translation), 4, 4)
        return self._clip_fit(result, T, ground_known=ground_known)

    def _clip_fit(
        self, result: Reconstruction, T: Float[Tensor, "clips 4 4"], *, ground_known: bool
    ) -> ClipFit:
        grounded = self.options.grounded
        return ClipFit(
            result,
            self.noises,
            ground_known,
            T,
            self.settled(result),
            grounded=grounded,
            ground_seen=grounded and not ground_known and self.ground_seen,
        )

    @property
    def long(self) -> bool:
        """Whether the recording is fitted by windows."""
        motion = self.guess.motion
        return (motion.frames - 1) / motion.fps > LONG

    @property
    def moved(self) -> frozenset[str]:
        """Names of the scene's unknowns that are optimised, except the ground."""
        found = OFFSETS if self.offsets else frozenset()
        return found | LENS if self.lens_unknown else found

    @property
    def lens_unknown(self) -> bool:
        """Whether one view of unknown pose is all there is, and its focal length is a guess."""
        # moving cameras keep the focal length that their tracker assumed
        return self.scale_unknown and not views_of(self.observations)[0].focal_known

    @property
    def one_view(self) -> bool:
        """Whether there is only one view: then standing feet alone determine the person's size."""
        return len(self.observations) == len(views_of(self.observations)) == 1

    @property
    def scale_unknown(self) -> bool:
        """Whether there is only one view, from a fixed camera of unknown pose."""
        if not self.one_view:
            return False
        (view,) = views_of(self.observations)
        return not view.ground_known and view.camera.T_camera_world.shape[-3] == 1

    def scene(self, start: Motion, ground: UnknownGround | None = None) -> Scene:
        """A scene with no offsets of keypoints, and a ground."""
        clips = len(start.translation)
        scene = Scene.create(clips, self.offsets, like=start.translation)
        if not self.lens_unknown:
            return scene.replace(ground=ground)
        pelvis = self.body.pose(start).joints[..., :1, :].mean(-3, keepdim=True)
        depth = views_of(self.observations)[0].camera.to_camera(pelvis)[..., 2].flatten(1)
        return scene.replace(ground=ground, lens=UnknownLens.create(depth[:, 0]))

    @property
    def pose_prior_options(self) -> FitOptions:
        """Options to fit first motions by the pose prior, which needs no ground."""
        known = self.options
        return replace(ROUGH, shape=known.shape, shape_prior=known.shape_prior)

    def stages(self, options: FitOptions, moved: frozenset[str], body: BodyModel) -> Stages:
        """The prior's stages, with a known shape, unknowns of the scene and further terms."""
        noise = min(noise.metres for noise in self.noises)
        prior = prior_stages(options, noise, body)
        known = options.shape_prior
        of_shape = () if known is None else known.terms(body, noise)
        terms = tuple(term.to(device=self.options.device) for term in options.terms)
        if moved >= OFFSETS:
            weight = (noise * OFFSET_UNIT / KEYPOINT_OFFSET_DEVIATION) ** 2
            terms = (*terms, Term("offsets", offsets, weight))
        if moved >= LENS:
            terms = (*terms, Term("lens", lens_changed, (noise / LENS_DEVIATION) ** 2))
        if moved >= GROUND and self.ground_seen:
            terms = (*terms, Term("ground", ground_moved, (noise / GROUND_DEVIATION) ** 2))

        def stages_for(data: tuple[Term, ...]) -> tuple[Stage[Any], ...]:
            stages = prior(data)
            if options.shape is not None:
                stages = shape_held(stages)
            elif known is not None:
                stages = with_shape_terms(stages, of_shape)
            elif self.one_view:
                stages = shape_found_once(stages)
            if self.scale_unknown:
                stages = with_relative_accelerations(stages)
            stages = with_scene(stages, moved, terms)
            if self.guess.posed:
                return after_placement(stages)
            if not self.guess.distance_known:
                return keeping_distance(stages)
            return without_root(stages) if self.guess.aligned else stages

        return stages_for

    def fit(
        self, options: FitOptions, scene: Scene, start: Motion, moved: frozenset[str]
    ) -> Reconstruction:
        """Fit the whole clip from an initial motion, optimising the unknowns `moved` of the scene.

        It is minimised on the device of the options; the result is on the device of the data.
        Long clips find the scene in their first seconds and keep it.
        """
        run = solve
        if self.long:
            # imported here: most recordings are short
            from recon.fitting.long import fit_long

            run = fit_long
        if self.long and moved:
            first = self.first_seconds()
            shorter = start.window(0, first.guess.motion.frames)
            scene, moved = first.fit(options, scene, shorter, moved).estimate.scene, frozenset()
        body = self.body.to(device=self.options.device)
        found = run(
            self.observations, self.stages(options, moved, body), body, scene=scene, start=start,
            weights=weights_of(self.noises), watch=self.watch,
        )  # fmt: skip
        return found.on_device_of(self.body)

    def on_known_ground(self) -> Motion:
        """A first motion under the pose prior, scaled about the camera to stand on the ground.

        What a camera sees does not change when everything is farther and larger by one factor.
        """
        free = self.pose_prior_motion()
        view = views_of(self.observations)[0]
        eye = view.camera.T_world_camera[..., :3, 3].mean(-2)
        factor = eye[:, 2] / (eye[:, 2] - sole_heights(free, self.body))
        factor = torch.where((factor > 1 / _MOST) & (factor < _MOST), factor, 1.0)
        pelvis = self.body.rest_joints(free.shape)[:, 0]
        place = free.translation + (pelvis - eye)[:, None]
        return free.replace(translation=place * factor[:, None, None] - (pelvis - eye)[:, None])

    @property
    def ground_seen(self) -> bool:
        """Whether the recording's z = 0 was laid on a plane that is given or seen."""
        seen = any(one.ground_seen for one in self.observations)
        return seen or self.options.ground_given

    def settled(self, result: Reconstruction) -> tuple[Sensor, ...]:
        """The observations with the scene's fitted unknowns inserted as known."""
        scene = result.estimate.scene.detach()
        return tuple(one.settled(scene) for one in self.observations)

    def pose_prior_motion(self) -> Motion:
        """A first motion under the pose prior, which needs no ground."""
        start = self.guess.motion
        return self.fit(self.pose_prior_options, self.scene(start), start, frozenset()).motion

    def with_camera_scale(self) -> "ClipProblem":
        """The problem with the camera's path scaled to metres by the feet of a first motion."""
        views = views_of(self.observations)
        if len(self.observations) > 1 or not views or views[0].unit_known:
            return self
        (view,) = views
        motion = self.pose_prior_motion()
        feet = self.body.pose(motion).joints[..., list(_BALLS), :]
        there, _ = view.at_own_times(feet, motion)
        if there.shape[-3] < view.moments:
            return self
        # imported here: only moving cameras need it
        from observations.camera_paths import with_path_in_metres

        seen = view.camera.to_camera(there).detach().double().numpy()
        found = with_path_in_metres(view, seen)
        moved = found.camera.T_world_camera[..., :3, 3] - view.camera.T_world_camera[..., :3, 3]
        if motion.frames == view.moments:
            motion = motion.replace(translation=motion.translation + moved)
        return replace(self, observations=(found,), guess=replace(self.guess, motion=motion))

    def with_ground(self) -> Reconstruction:
        """Fit the whole clip and its unknown ground, whose first guess is below standing feet."""
        # imported here: in most clips the ground is known
        from recon.fitting.ground import ground_below, pelvis_path, upright_ground

        start = self.guess.motion
        # z is up and only the height of the ground is unknown
        if frame_is_level(self.observations):
            start, unknown = self.pose_prior_motion(), HEIGHT
            ground = ground_below(start, self.body)
        elif self.ground_seen:
            ground, unknown = UnknownGround.create(pelvis_path(start, self.body)), GROUND
        else:
            start, unknown = self.pose_prior_motion(), GROUND
            ground = upright_ground(start, self.body)
        if not self.options.knows_gravity:
            unknown = frozenset()
        return self.fit(self.options, self.scene(start, ground), start, self.moved | unknown)

    def first_seconds(self) -> "ClipProblem":
        """The first seconds of the clip, as long as a window of a long recording."""
        from recon.fitting.long import WINDOW  # imported here: only long recordings need it

        begin = self.guess.motion.start_time
        frames = round(WINDOW * self.guess.motion.fps) + 1  # both ends of the window are counted
        seen = tuple(o.window(begin, begin + WINDOW) for o in self.observations)
        guess = replace(self.guess, motion=self.guess.motion.window(0, frames))
        return replace(self, observations=seen, guess=guess)

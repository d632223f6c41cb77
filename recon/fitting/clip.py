"""Fits one clip: first guess, noise weights, unknown ground and lens, then the prior's stages."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import torch
from jaxtyping import Float
from torch import Tensor

from observations.first_guess import FirstGuess, with_first_guess
from observations.noise import weights_of
from observations.points import OFFSET_UNIT
from priors.checkpoints import FIRST
from recon.body.model import BodyModel
from recon.core.motion import Motion
from recon.core.residuals import Noise
from recon.core.scene import GROUND, HEIGHT, LENS, OFFSETS, Scene, UnknownGround, UnknownLens
from recon.fitting.methods import FitOptions
from recon.fitting.records import ClipFit
from recon.fitting.stages import (
    for_one_view,
    from_first_pose_stage,
    from_first_prior_stage,
    prior_stages,
    with_relative_accelerations,
    with_scene,
    with_shape_found_once,
    with_shape_held,
    with_shape_terms,
)
from recon.method.reconstruction import Reconstruction, solve
from recon.method.sensor import Sensor, frame_is_level, views_of
from recon.method.stages import Stage, Stages, Watch
from recon.method.terms import Term, ground_moved, lens_changed, offsets

LONG = 10.0
"""Duration (s) above which recordings are fitted by overlapping windows."""
KEYPOINT_OFFSET_DEVIATION = 0.005
"""Standard deviation (m) between people of the place where a detector sees a joint, for one frame.
The true one is 1 to 2 cm; this is smaller as errors of neighbouring frames are correlated."""
GROUND_DEVIATION = 0.001
"""Standard deviation (m and rad) of the ground from a plane that is given or seen: thousands of
points show it, and no step of a person should outweigh them."""


def fit_clip(
    observations: Sequence[Sensor],
    options: FitOptions,
    body: BodyModel,
    watch: Watch | None = None,
    start: Motion | None = None,
) -> ClipFit:
    """Fit clips to observations in the frame of the recording, with a leading axis of clips.

    Clips of one batch are assumed to be equally noisy; a long recording must be the only clip.

    If the ground is not known, the pose prior alone finds a first motion, whose standing feet and
    posture give a first ground, and the prior's stages refine both. Recordings longer than `LONG`
    keep the ground found in their first seconds. Without any ground (`options.grounded`) only the
    motion is fitted, in the frame of the observations.

    Args:
        observations: sensors' data of the clips.
        options: prior, noise and known quantities.
        body: body model to be fitted.
        watch: called after every iteration.
        start: an earlier fit in the observations' frame, axes (clips, time); None for none.

    Raises:
        ValueError: when some observations know the ground and others do not, or the start does
            not fit the observations.
    """
    seen, guess = with_first_guess(observations, body, start, options.starting_shape)
    guess = replace(guess, posed=start is not None)
    return clip_problem(seen, guess, options, body, watch).solved()


def clip_problem(
    observations: tuple[Sensor, ...],
    guess: FirstGuess,
    options: FitOptions,
    body: BodyModel,
    watch: Watch | None = None,
) -> "ClipProblem":
    """Set up the fit: observations weighted by their noise, and the first motion."""
    noises = tuple(
        one.noise(guess.motion, body, options.noise_of(row))
        for row, one in enumerate(observations)
    )
    seen, offsets = _with_keypoint_offsets(observations)
    return ClipProblem(seen, guess, noises, offsets, body, options, watch)


def _with_keypoint_offsets(observations: tuple[Sensor, ...]) -> tuple[tuple[Sensor, ...], int]:
    """Add unknown keypoint offsets to several views of one layout; also return their number."""
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
    """Number of keypoints with an unknown offset, which are the rows of `Scene.offsets`."""
    body: BodyModel
    options: FitOptions
    watch: Watch | None
    repetition: float = 1.0
    """Number of frames of a view that tell as much as one with independent errors."""

    def solved(self) -> ClipFit:
        """Fit the motion, and the ground where it is not known."""
        if self.options.grounded and all(one.ground_known for one in self.observations):
            return self._fit_in_recording_frame(ground_known=True)
        clip = self._with_camera_path_in_metres()
        if not self.options.grounded:
            return clip._fit_in_recording_frame(ground_known=False)
        result = clip._fit_with_ground()
        assert result.estimate.scene.ground is not None
        T = result.estimate.scene.ground.T_world_recording.detach()
        return clip._clip_fit(result, T, ground_known=False)

    def _fit_in_recording_frame(self, *, ground_known: bool) -> ClipFit:
        """Fit in the recording's frame, where the ground is z = 0 or is not fitted at all."""
        clip, start = self, self.guess.motion
        if ground_known and not self.guess.distance_known:
            from recon.fitting.first_motions import scaled_onto_ground  # imported only for images

            clip, free = self.after_pose_prior()
            start = scaled_onto_ground(free, cast(Any, views_of(self.observations)[0]), self.body)
        result = clip.fit(clip.options, clip.initial_scene(start), start, clip.optimised_unknowns)
        T = torch.eye(4).expand(len(start.translation), 4, 4)
        return self._clip_fit(result, T, ground_known=ground_known)

    def after_pose_prior(self) -> "tuple[ClipProblem, Motion]":
        """Fit under the pose prior, which needs no ground; return the problem and the motion.

        If there is one view of unspecified noise, the returned problem weights it less where its
        residuals about this motion repeat from frame to frame: feet would follow them and slip.
        """
        start = self.guess.motion
        first = self.fit(self.pose_prior_options, self.initial_scene(start), start, frozenset())
        if not self.one_view or self.options.noise_of(0) is not None:
            return self, first.motion
        from recon.fitting.first_motions import correlated_view_frames  # imported only for images

        (view,) = views_of(self.observations)
        found = correlated_view_frames(cast(Any, view), first.estimate, self.noises[0].own)
        return replace(self, repetition=found), first.motion

    def _with_camera_path_in_metres(self) -> "ClipProblem":
        """Scale the moving camera's path to metres, by the standing feet of a first motion."""
        views = views_of(self.observations)
        if len(self.observations) > 1 or not views or views[0].unit_known:
            return self
        from recon.fitting.first_motions import scaled_to_feet  # imported only for moving cameras

        _, motion = self.after_pose_prior()
        if (found := scaled_to_feet(cast(Any, views[0]), motion, self.body)) is None:
            return self
        view, motion = found
        return replace(self, observations=(view,), guess=replace(self.guess, motion=motion))

    def _fit_with_ground(self) -> Reconstruction:
        """Fit the whole clip and its unknown ground, whose first guess is below standing feet."""
        # imported only when the ground is unknown
        from recon.fitting.ground import ground_by_feet, ground_by_posture, point_below_pelvis

        clip, start, level = self, self.guess.motion, frame_is_level(self.observations)
        if self.ground_seen and not level:
            ground = UnknownGround.create(point_below_pelvis(start, self.body))
        else:
            clip, start = self.after_pose_prior()
            ground = (ground_by_feet if level else ground_by_posture)(start, self.body)
        moved = self.optimised_unknowns
        if self.options.knows_gravity:
            # if the z axis points up, only the height of the ground is unknown
            moved |= HEIGHT if level else GROUND
        return clip.fit(clip.options, clip.initial_scene(start, ground), start, moved)

    def _clip_fit(
        self, reconstruction: Reconstruction, T: Float[Tensor, "clips 4 4"], *, ground_known: bool
    ) -> ClipFit:
        grounded = self.options.grounded
        return ClipFit(
            reconstruction,
            self.noises,
            ground_known,
            T,
            self.with_fitted_scene(reconstruction),
            grounded=grounded,
            ground_seen=grounded and not ground_known and self.ground_seen,
        )

    @property
    def is_long(self) -> bool:
        """Whether the recording is fitted by windows, as it is longer than `LONG`."""
        return self.guess.motion.duration > LONG

    @property
    def optimised_unknowns(self) -> frozenset[str]:
        """Names of the scene's unknowns that are optimised, except the ground."""
        found = OFFSETS if self.offsets else frozenset()
        return found | LENS if self.lens_unknown else found

    @property
    def lens_unknown(self) -> bool:
        """Whether the only sensor is one view of unknown pose with a guessed focal length."""
        # moving cameras keep the focal length that their tracker assumed
        return self.scale_unknown and views_of(self.observations)[0].focal_std > 0

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

    def initial_scene(self, start: Motion, ground: UnknownGround | None = None) -> Scene:
        """Create the scene before a fit: zero keypoint offsets, a ground, a lens where unknown."""
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
        return FitOptions(prior=FIRST, shape=known.shape, shape_prior=known.shape_prior)

    def stages(self, options: FitOptions, moved: frozenset[str], body: BodyModel) -> Stages:
        """Return a function that makes the prior's stages for data, adapted to shape and scene."""
        noise = min(noise.metres for noise in self.noises)
        prior = prior_stages(options, noise, body)
        known = options.shape_prior
        of_shape = () if known is None else known.terms(body, noise)
        terms = tuple(term.to(device=self.options.device) for term in options.terms)
        if moved >= OFFSETS:
            weight = (noise * OFFSET_UNIT / KEYPOINT_OFFSET_DEVIATION) ** 2
            terms = (*terms, Term("offsets", offsets, weight))
        if moved >= LENS:
            std = views_of(self.observations)[0].focal_std
            terms = (*terms, Term("lens", lens_changed, (noise / std) ** 2))
        if moved >= GROUND and self.ground_seen:
            terms = (*terms, Term("ground", ground_moved, (noise / GROUND_DEVIATION) ** 2))

        def stages_for(data: tuple[Term, ...]) -> tuple[Stage[Any], ...]:
            stages = prior(data)
            if options.shape is not None:
                stages = with_shape_held(stages)
            elif known is not None:
                stages = with_shape_terms(stages, of_shape)
            elif self.one_view:
                stages = with_shape_found_once(stages)
            if self.scale_unknown:
                stages = with_relative_accelerations(stages)
            stages = with_scene(stages, moved, terms)
            if self.one_view:
                from recon.fitting.still_feet import with_still_feet  # imported only for images

                (one,) = self.noises
                # data terms after the first only tie windows to each other
                (view,) = views_of([cast(Any, data[0].energy)])
                stages = with_still_feet(stages, view, body, one.metres / one.own)
            if self.guess.posed:
                return from_first_prior_stage(stages)
            if not self.guess.distance_known:
                return for_one_view(stages)
            return from_first_pose_stage(stages) if self.guess.aligned else stages

        return stages_for

    def fit(
        self, options: FitOptions, scene: Scene, start: Motion, moved: frozenset[str]
    ) -> Reconstruction:
        """Fit the whole clip from an initial motion, optimising the unknowns `moved` of the scene.

        The fit runs on the device of the options; the result is on the device of the data. Long
        clips find the scene in their first seconds and keep it.
        """
        run = solve
        if self.is_long:
            # imported only when a recording is long
            from recon.fitting.long import fit_long

            run = fit_long
        if self.is_long and moved:
            first = self.first_seconds()
            shorter = start.window(0, first.guess.motion.frames)
            scene, moved = first.fit(options, scene, shorter, moved).estimate.scene, frozenset()
        body = self.body.to(device=self.options.device)
        found = run(
            self.observations, self.stages(options, moved, body), body, scene=scene, start=start,
            weights=[one / self.repetition for one in weights_of(self.noises)], watch=self.watch,
        )  # fmt: skip
        return found.on_device_of(self.body)

    @property
    def ground_seen(self) -> bool:
        """Whether the recording's z = 0 was laid on a plane that is given or seen."""
        seen = any(one.ground_seen for one in self.observations)
        return seen or self.options.ground_given

    def with_fitted_scene(self, result: Reconstruction) -> tuple[Sensor, ...]:
        """Return the observations with the scene's fitted unknowns inserted as known."""
        scene = result.estimate.scene.detach()
        return tuple(one.with_constants_of(scene) for one in self.observations)

    def first_seconds(self) -> "ClipProblem":
        """Cut out the first seconds of the clip, as long as a window of a long recording."""
        from recon.fitting.long import WINDOW  # imported only when a recording is long

        begin = self.guess.motion.start_time
        frames = round(WINDOW * self.guess.motion.fps) + 1  # both ends of the window are counted
        seen = tuple(o.window(begin, begin + WINDOW) for o in self.observations)
        guess = replace(self.guess, motion=self.guess.motion.window(0, frames))
        return replace(self, observations=seen, guess=guess)

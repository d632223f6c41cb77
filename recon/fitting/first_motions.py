"""First motions under the pose prior, of clips whose ground, size or camera's scale is not known.

The pose prior needs no ground. Its motion gives a first ground, the unit of a camera's path, and
how long the errors of one view last.
"""

from dataclasses import replace

import torch

from observations.noise import error_repetition
from recon.body.soles import sole_heights
from recon.core.motion import Motion
from recon.core.scene import GROUND, HEIGHT, UnknownGround
from recon.core.skeleton import joint_index
from recon.fitting.clip import ClipProblem
from recon.fitting.ground import ground_below, pelvis_path, upright_ground
from recon.method.protocols import REFERENCE_FPS
from recon.method.reconstruction import Reconstruction
from recon.method.sensor import frame_is_level, views_of

_BALLS = [joint_index("left_foot"), joint_index("right_foot")]
_MOST = 1.5
"""Factor by which sizes may be wrong at first; beyond it, camera and ground contradict."""


def after_pose_prior(problem: ClipProblem) -> tuple[ClipProblem, Motion]:
    """A motion under the pose prior, and the problem with errors of one view that last.

    One view whose noise nobody gave weighs less where its residuals about this motion repeat from
    frame to frame (`error_repetition`); feet would follow them and slip.
    """
    start = problem.guess.motion
    first = problem.fit(problem.pose_prior_options, problem.scene(start), start, frozenset[str]())
    if not problem.one_view or problem.options.noise_of(0) is not None:
        return problem, first.motion
    (view,) = views_of(problem.observations)
    with torch.no_grad():
        left = view.residuals(first.estimate)
    found = error_repetition(
        left.values * left.weights[..., None], left.seen, problem.noises[0].own,
        REFERENCE_FPS / view.fps,
    )  # fmt: skip
    return replace(problem, repetition=found), first.motion


def on_known_ground(problem: ClipProblem) -> tuple[ClipProblem, Motion]:
    """`after_pose_prior`, the motion scaled about the camera to stand on the ground.

    What a camera sees does not change when everything is farther and larger by one factor.
    """
    problem, free = after_pose_prior(problem)
    body, (view,) = problem.body, views_of(problem.observations)[:1]
    eye = view.camera.T_world_camera[..., :3, 3].mean(-2)
    factor = eye[:, 2] / (eye[:, 2] - sole_heights(free, body))
    factor = torch.where((factor > 1 / _MOST) & (factor < _MOST), factor, 1.0)
    pelvis = body.rest_joints(free.shape)[:, 0]
    place = free.translation + (pelvis - eye)[:, None]
    scaled = place * factor[:, None, None] - (pelvis - eye)[:, None]
    return problem, free.replace(translation=scaled)


def with_camera_scale(problem: ClipProblem) -> ClipProblem:
    """The problem with the camera's path scaled to metres by the feet of a first motion."""
    views = views_of(problem.observations)
    if len(problem.observations) > 1 or not views or views[0].unit_known:
        return problem
    (view,) = views
    _, motion = after_pose_prior(problem)
    feet = problem.body.pose(motion).joints[..., _BALLS, :]
    there, _ = view.at_own_times(feet, motion)
    if there.shape[-3] < view.moments:
        return problem
    # imported here: only moving cameras need it
    from observations.camera_paths import with_path_in_metres

    seen = view.camera.to_camera(there).detach().double().numpy()
    found = with_path_in_metres(view, seen)
    moved = found.camera.T_world_camera[..., :3, 3] - view.camera.T_world_camera[..., :3, 3]
    if motion.frames == view.moments:
        motion = motion.replace(translation=motion.translation + moved)
    return replace(problem, observations=(found,), guess=replace(problem.guess, motion=motion))


def with_ground(problem: ClipProblem) -> Reconstruction:
    """Fit the whole clip and its unknown ground, whose first guess is below standing feet."""
    start, body, level = problem.guess.motion, problem.body, frame_is_level(problem.observations)
    if problem.ground_seen and not level:
        ground = UnknownGround.create(pelvis_path(start, body))
    else:
        problem, start = after_pose_prior(problem)
        ground = (ground_below if level else upright_ground)(start, body)
    unknown = frozenset[str]()
    if problem.options.knows_gravity:
        # where z is up only the height of the ground is unknown
        unknown = HEIGHT if level else GROUND
    scene = problem.scene(start, ground)
    return problem.fit(problem.options, scene, start, problem.moved | unknown)

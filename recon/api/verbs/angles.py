"""`recon.joint_angles`: the joint angles of a motion as biomechanics names them."""

from typing import Literal

from recon.api.given import BodyLike, MotionLike, body_given, motion_given
from recon.api.results.angles import JointAngles
from recon.body.angles.isb import isb_angles
from recon.body.angles.opensim import TRANSLATIONS, opensim_coordinates
from recon.core.errors import ReconError


def joint_angles(
    motion: MotionLike,
    *,
    convention: Literal["isb", "rajagopal2016", "gait2392"] = "isb",
    body: BodyLike = None,
) -> JointAngles:
    """Joint angles of a motion, in degrees, on the motion's own clock.

    They have no standard deviations: those of joints are known without the correlations that an
    angle depends on.

    Args:
        motion: a motion of one clip.
        convention: the recommendations of the International Society of Biomechanics, whose names
            say what a positive angle is, or the coordinates of an OpenSim model.
        body: whose motion it is; the bundled one, whose bony landmarks are known.

    Raises:
        ReconError: when the body is another one, or the convention is none of these.
    """
    model = body_given(body)
    given = motion_given(motion, model).motion
    times = given.times.double().cpu().numpy()
    if convention == "isb":
        return JointAngles(convention, times, isb_angles(given, model), {})
    if convention not in ("rajagopal2016", "gait2392"):
        raise ReconError(
            f"convention: expected isb, rajagopal2016 or gait2392, got {convention!r}"
        )
    found = opensim_coordinates(given, model, convention)
    lengths = {name: values for name, values in found.items() if name in TRANSLATIONS}
    angles = {name: values for name, values in found.items() if name not in TRANSLATIONS}
    return JointAngles(convention, times, angles, lengths)

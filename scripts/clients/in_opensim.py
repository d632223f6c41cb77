"""Reads a .mot and a .trc file in OpenSim; runs in a Python with `opensim`, without recon.

    python in_opensim.py FILE.mot FILE.trc SIZES.json OUT.npz

A skeleton is built with the joints of Rajagopal2016.osim, axes and all, in the sizes of our body,
and moved by the coordinates of the .mot; then OpenSim's own inverse kinematics follows the markers
of the .trc on its pelvis, legs and feet.
"""

import json
import sys

import numpy as np
import opensim

ZERO = opensim.Vec3(0, 0, 0)
# orientations of joint frames (x-y-z, radians), as Rajagopal2016.osim has them on the right
PINS = {
    "ankle_angle": (0.175895, -0.105208, 0.0186622),
    "subtalar_angle": (-1.76819, 0.906223, 1.8196),
    "mtp_angle": (-3.14159, 0.619901, 0.0),
    "elbow_flex": (-0.0228627, 0.228018, 0.0051689),
    "pro_sup": (-1.56884, 0.056428, 1.53614),
}
WRIST = (-1.5708, 0.0, -1.5708)


def kept(function):
    """Mark a function as owned by the library, so that Python does not free it."""
    function.thisown = False
    return function


def custom(model, name, parent, place, child, names, axes):
    """Add a joint that turns about three axes in sequence; an axis without name is fixed."""
    transform = opensim.SpatialTransform()
    shifts = ("pelvis_tx", "pelvis_ty", "pelvis_tz") if name == "ground_pelvis" else ("", "", "")
    every = [("rotation", k, n, a) for k, (n, a) in enumerate(zip(names, axes, strict=True))]
    unit = np.eye(3).tolist()
    every += [("translation", k, n, unit[k]) for k, n in enumerate(shifts)]
    for kind, k, coordinate, axis in every:
        moved = getattr(transform, f"upd_{kind}{k + 1}")()
        moved.setAxis(opensim.Vec3(*axis))
        if coordinate:
            moved.setCoordinateNames(opensim.ArrayStr(coordinate, 1))
            moved.setFunction(kept(opensim.LinearFunction(1.0, 0.0)))
        else:
            moved.setFunction(kept(opensim.Constant(0.0)))
    at = opensim.Vec3(*place)
    model.addJoint(opensim.CustomJoint(name, parent, at, ZERO, child, ZERO, ZERO, transform))


def pin(model, coordinate, end, parent, place, child):
    """Add a joint that turns about the z axis of its frame."""
    x, y, z = PINS[coordinate]
    sign = 1 if end == "r" or coordinate == "mtp_angle" else -1
    turn = opensim.Vec3(sign * x, y if end == "r" else -y, z)
    name = f"{coordinate}_{end}"
    joint = opensim.PinJoint(
        f"joint_{name}", parent, opensim.Vec3(*place), turn, child, ZERO, turn
    )
    joint.updCoordinate().setName(name)
    model.addJoint(joint)


def built(sizes):
    model = opensim.Model()
    bodies = {}
    names = ["pelvis", "torso"] + [
        f"{name}_{end}"
        for end in "rl"
        for name in (
            "femur", "tibia", "talus", "calcn", "toes", "humerus", "ulna", "radius", "hand",
        )
    ]  # fmt: skip
    for name in names:
        bodies[name] = opensim.Body(name, 1.0, ZERO, opensim.Inertia(1, 1, 1))
        model.addBody(bodies[name])
    x, y, z = (1, 0, 0), (0, 1, 0), (0, 0, 1)
    ground, pelvis, torso = model.getGround(), bodies["pelvis"], bodies["torso"]
    tilt = ("pelvis_tilt", "pelvis_list", "pelvis_rotation")
    custom(model, "ground_pelvis", ground, (0, 0, 0), pelvis, tilt, (z, x, y))
    back = ("lumbar_extension", "lumbar_bending", "lumbar_rotation")
    custom(model, "back", pelvis, sizes["torso"], torso, back, (z, x, y))
    for end in "rl":
        s = 1 if end == "r" else -1
        b = {n[:-2]: body for n, body in bodies.items() if n.endswith(f"_{end}")}
        at = {n[:-2]: place for n, place in sizes.items() if n.endswith(f"_{end}")}
        three = (z, (s, 0, 0), (0, s, 0))
        hip = tuple(f"hip_{n}_{end}" for n in ("flexion", "adduction", "rotation"))
        custom(model, f"hip_{end}", pelvis, at["femur"], b["femur"], hip, three)
        knee = (f"knee_angle_{end}", "", "")
        custom(model, f"knee_{end}", b["femur"], at["tibia"], b["tibia"], knee, ((0, 0, -1), x, y))
        pin(model, "ankle_angle", end, b["tibia"], at["foot"], b["talus"])
        pin(model, "subtalar_angle", end, b["talus"], (0, 0, 0), b["calcn"])
        pin(model, "mtp_angle", end, b["calcn"], at["toes"], b["toes"])
        arm = tuple(f"arm_{n}_{end}" for n in ("flex", "add", "rot"))
        custom(model, f"acromial_{end}", torso, at["humerus"], b["humerus"], arm, three)
        pin(model, "elbow_flex", end, b["humerus"], at["forearm"], b["ulna"])
        pin(model, "pro_sup", end, b["ulna"], (0, 0, 0), b["radius"])
        turn = opensim.Vec3(s * WRIST[0], 0, s * WRIST[2])
        wrist = opensim.UniversalJoint(
            f"radius_hand_{end}", b["radius"], opensim.Vec3(*at["hand"]), turn, b["hand"], ZERO,
            turn,
        )  # fmt: skip
        wrist.updCoordinate(opensim.UniversalJoint.Coord_Rotation1X).setName(f"wrist_flex_{end}")
        wrist.updCoordinate(opensim.UniversalJoint.Coord_Rotation2Y).setName(f"wrist_dev_{end}")
        model.addJoint(wrist)
    return model


def places(row):
    """Return the positions of all markers of a frame; OpenSim's rows end no `for` loop."""
    return [[row[k][axis] for axis in range(3)] for k in range(row.ncol())]


def matrix(body, state):
    turn = body.getTransformInGround(state).R()
    return [[turn.asMat33().get(i, j) for j in range(3)] for i in range(3)]


def moved(model, table, frames):
    """Compute orientations of all bodies in the ground by the coordinates of a .mot file."""
    state = model.initSystem()
    labels = [str(name) for name in table.getColumnLabels()]
    coordinates = model.getCoordinateSet()
    known = [n for n in labels if coordinates.contains(n)]
    bodies = [model.getBodySet().get(k) for k in range(model.getBodySet().getSize())]
    found = {body.getName(): [] for body in bodies}
    for frame in frames:
        row = table.getRowAtIndex(frame)
        for name in known:
            value = row[labels.index(name)]
            length = name in ("pelvis_tx", "pelvis_ty", "pelvis_tz")
            coordinates.get(name).setValue(state, value if length else np.deg2rad(value), False)
        model.realizePosition(state)
        for body in bodies:
            found[body.getName()].append(matrix(body, state))
    return labels, known, found


def followed(model, trc, markers, frames, times):
    """Fit coordinates to the markers by OpenSim's inverse kinematics, degrees."""
    for name, (body, place) in markers.items():
        model.addMarker(opensim.Marker(name, model.getBodySet().get(body), opensim.Vec3(*place)))
    model.finalizeConnections()
    state = model.initSystem()
    weights = opensim.SetMarkerWeights()
    for name in markers:
        weights.cloneAndAppend(opensim.MarkerWeight(name, 1.0))
    reference = opensim.MarkersReference(trc, weights)
    solver = opensim.InverseKinematicsSolver(
        model, reference, opensim.SimTKArrayCoordinateReference()
    )
    solver.setAccuracy(1e-6)
    every = [model.getCoordinateSet().get(k) for k in range(model.getCoordinateSet().getSize())]
    found = {one.getName(): [] for one in every}
    for k, frame in enumerate(frames):
        state.setTime(times[frame])
        (solver.track if k else solver.assemble)(state)
        for one in every:
            found[one.getName()].append(np.rad2deg(one.getValue(state)))
    return found


def main(mot, trc, sizes, out):
    opensim.Logger.setLevelString("Error")
    with open(sizes) as file:
        given = json.load(file)
    table = opensim.TimeSeriesTable(mot)
    points = opensim.TimeSeriesTableVec3(trc)
    frames = given["frames"]
    labels, known, found = moved(built(given["places"]), table, frames)
    arrays = {f"body {name}": np.array(values) for name, values in found.items()}
    times = [float(t) for t in points.getIndependentColumn()]
    arrays["markers"] = np.array([places(points.getRowAtIndex(frame)) for frame in frames])
    follow = followed(built(given["places"]), trc, given["markers"], frames, times)
    arrays |= {f"ik {name}": np.array(values) for name, values in follow.items()}
    np.savez(out, **arrays)
    said = {
        "version": opensim.GetVersion(),
        "coordinates": labels,
        "unknown coordinates": [name for name in labels if name not in known],
        "markers": [str(name) for name in points.getColumnLabels()],
        "first_time": {"mot": float(table.getIndependentColumn()[0]), "trc": times[0]},
        "frames": {"mot": table.getNumRows(), "trc": points.getNumRows()},
        "units": points.getTableMetaDataString("Units"),
    }
    sys.stdout.write(json.dumps(said) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])

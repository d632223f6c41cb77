"""The committed results of `make clients`: our files in the programs that they are for."""

import ast
from typing import get_args

from benchmarks.clients.__main__ import LIMITS
from benchmarks.protocol import RESULTS, Table
from recon.core.bone_names import BoneNames


def test_the_committed_result_is_within_its_limits_and_names_its_versions():
    rows = Table.read(RESULTS / "clients.json").rows
    found = {name: value for name, value, _ in rows}
    assert {name: limit for name, _, limit in rows if limit is not None} == LIMITS
    for name, limit in LIMITS.items():
        assert found[name] <= limit, name
    for client in ("three", "vrm", "gltf_validator", "blender", "usd", "opensim"):
        assert str(found[client])[:1].isdigit(), client
    assert found["opensim_markers"] == 105
    # OpenSim's own inverse kinematics of our markers finds our hips and knees
    apart = dict(ast.literal_eval(str(found["opensim_ik_deg"])))
    for joint in ("hip_flexion", "hip_adduction", "knee_angle"):
        for end in ("r", "l"):
            assert apart[f"{joint}_{end}"] < 1.0


def test_joints_and_fingers_are_in_place_under_the_names_of_every_program():
    table = Table.read(RESULTS / "clients-names.json")
    assert tuple(row[0] for row in table.rows) == get_args(BoneNames)
    for program, *values in table.rows:
        for (name, _), value in zip(table.columns[1:], values, strict=True):
            if name.startswith("vrm") and program != "vrm":
                assert value is None
            else:
                assert isinstance(value, int | float)
                assert value <= LIMITS[name], (program, name)

"""The committed result of `make clients`: our files in the programs that they are for."""

import ast

from benchmarks.clients.__main__ import LIMITS
from benchmarks.protocol import RESULTS, Table


def test_the_committed_result_is_within_its_limits_and_names_its_versions():
    rows = Table.read(RESULTS / "clients.json").rows
    found = {name: value for name, value, _ in rows}
    assert {name: limit for name, _, limit in rows if limit is not None} == LIMITS
    for name, limit in LIMITS.items():
        assert found[name] <= limit, name
    for client in ("three", "gltf_validator", "blender", "usd", "opensim"):
        assert str(found[client])[:1].isdigit(), client
    assert found["opensim_markers"] == 105
    # OpenSim's own inverse kinematics of our markers finds our hips and knees
    apart = dict(ast.literal_eval(str(found["opensim_ik_deg"])))
    for joint in ("hip_flexion", "hip_adduction", "knee_angle"):
        for end in ("r", "l"):
            assert apart[f"{joint}_{end}"] < 1.0

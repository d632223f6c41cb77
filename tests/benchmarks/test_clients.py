"""The committed result of `make clients`: our files in the programs that they are for."""

import json

from benchmarks.clients.__main__ import LIMITS
from benchmarks.results import RESULTS


def test_the_committed_result_is_within_its_limits_and_names_its_versions():
    said = json.loads((RESULTS / "clients.json").read_text(encoding="utf-8"))
    (found,) = said["rows"]
    assert said["limits"] == LIMITS
    for name, limit in LIMITS.items():
        assert found[name] <= limit, name
    for client in ("three", "gltf_validator", "blender", "usd", "opensim"):
        assert str(found[client])[:1].isdigit(), client
    assert found["opensim_markers"] == 105
    assert found["opensim_frames"]["mot"] == found["opensim_frames"]["trc"]
    assert found["opensim_frames"]["mot"] == found["usd_time_codes"]
    # OpenSim's own inverse kinematics of our markers finds our hips and knees
    for joint in ("hip_flexion", "hip_adduction", "knee_angle"):
        for end in ("r", "l"):
            assert found["opensim_ik_deg"][f"{joint}_{end}"] < 1.0

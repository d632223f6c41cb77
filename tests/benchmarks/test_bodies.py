"""What is judged of HUMOS's network, on rows and motions whose answer is known."""

from pathlib import Path

import pytest
import torch

from benchmarks.bodies import network, whose
from benchmarks.bodies.kept import Kept
from benchmarks.retarget_clips import Job
from benchmarks.tables import humos as tables
from recon.body.model import BodyModel
from recon.body.motion_files import leg_length
from tests.walking import a_walk

BODY = BodyModel.load()
WALK = {"cadence": 100.0, "step": 0.7, "speed": 1.2, "sway": 0.02, "arms": 30.0}


def test_rows_are_measured_again_by_another_commit_alone(tmp_path: Path) -> None:
    calls: list[int] = []

    def measure():
        calls.append(1)
        return [{"value": len(calls)}]

    first = Kept(tmp_path, {"weights": "open"}, "a" * 40)
    assert [first.rows("a clip", measure) for _ in range(2)] == [[{"value": 1}]] * 2
    assert first.rows("another clip", measure) == [{"value": 2}]
    assert Kept(tmp_path, {"weights": "nc"}, "a" * 40).rows("a clip", measure) == [{"value": 3}]
    assert Kept(tmp_path, {"weights": "nc"}, "b" * 40).rows("a clip", measure) == [{"value": 4}]
    dirty = Kept(tmp_path, {"weights": "nc"}, "b" * 40 + "+")
    assert [dirty.rows("a clip", measure)[0]["value"] for _ in range(2)] == [5, 6]


def test_clips_of_a_subject_have_both_kinds_of_bodies() -> None:
    """The table has bodies of people at even places: every second clip had them alone."""
    walk = a_walk(BODY)
    jobs = [Job(f"{s}_{k}", s, walk, walk.shape, k % 2 == 0, flies=False)
            for s in ("06", "27") for k in range(7 if s == "06" else 1)]  # fmt: skip
    found = network.chosen(jobs, 4)
    assert [job.real for job in found] == [True, True, False, False, True]
    assert len({job.name for job in found}) == 5


def test_contacts_that_nobody_says_are_half_right() -> None:
    true = torch.tensor([[True, False], [True, False], [False, True]])
    assert network.contacts_right(true, true) == 1.0
    assert network.contacts_right(torch.zeros_like(true), true) == 0.5
    assert network.contacts_right(true, torch.zeros_like(true)) is None


def test_statistics_of_a_made_up_walk() -> None:
    """Hips swing once a second, 1.2 m/s ahead in a straight line, arms hang."""
    walk = a_walk(BODY, seconds=5.0, period=1.0, speed=1.2, fps=60.0)
    found = whose.statistics(walk, BODY)
    assert found is not None
    leg = float(leg_length(BODY, walk.shape))
    assert found["cadence"] == pytest.approx(120, rel=0.02)
    assert found["speed"] * leg == pytest.approx(1.2, rel=0.05)
    assert found["step"] * leg == pytest.approx(0.6, rel=0.05)
    assert found["sway"] < 1e-3
    assert found["arms"] < 1.0


def test_who_stands_still_has_no_statistics() -> None:
    still = a_walk(BODY, seconds=2.0, fps=60.0).map(lambda tensor: tensor.clone())
    still = still.replace(
        rotations=still.rotations[:1].expand_as(still.rotations),
        translation=still.translation[:1].expand_as(still.translation),
    )
    assert whose.statistics(still, BODY) is None


def test_a_network_that_makes_the_other_persons_walk_goes_all_the_way() -> None:
    other = {key: 1.5 * value for key, value in WALK.items()}
    made = {"scaled copy": WALK, "network": other, "codes": WALK}
    rows = [
        {"clip": f"{k}", "person": "a", "body": "b", "method": method, "made": walk,
         "own": WALK, "other": other}
        for k in range(3) for method, walk in made.items()
    ]  # fmt: skip
    recorded = {"a": [WALK, WALK], "b": [other, other]}
    units = {key: 0.1 * value for key, value in WALK.items()}
    found = {"rows": rows, "spreads": units, "learned": [], "recorded": recorded}
    line = tables.whose_lines(found).splitlines()[-1].split("|")[1:-1]
    cells = [cell.strip() for cell in line]
    # own, copy, network, codes, differences of the last two, shares of the way
    assert cells[1] == "0.00"
    assert [cell.split()[0] for cell in cells[2:8]] == (
        ["5.00", "5.00", "0.00", "5.00", "-5.00", "0.00"]
    )
    assert cells[8:] == ["100.0", "0.0"]


def test_differences_of_a_person_are_of_the_same_windows() -> None:
    rows = [
        {"clip": "06_01", "window": f"06_01@{k}", "subject": "06", "protocol": "noisy joints",
         "method": method, "error": 0.02 + 0.001 * k + worse, "slip": None}
        for k in range(3)
        for method, worse in (("stages 1-2", 0.0), ("physics", 0.0), ("humos", 0.01))
    ]  # fmt: skip
    text = tables.people_lines({"rows": rows, "apart": []}, "noisy joints")
    person = text.splitlines()[2]
    assert "2.10, 2.10, 3.10" in person
    assert person.count("**1.00 [1.00, 1.00]**") == 2
    assert person.count("–") >= 3  # slip is not known

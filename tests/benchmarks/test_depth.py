"""Tables of depth from the values of single windows."""

from benchmarks.cloud_cases import OTHERS
from benchmarks.depth import NAMES, Found, tables


def file(case: str, **windows: float) -> dict:
    """Windows of three people, and the errors of their fits, metres."""
    names = [f"{who}_01@0.00" for who in ("07", "16", "49")]
    rows = [{"root_all": error, "said": 0.0} for error in windows.values()]
    values = {case: {"recon": dict(zip(names, rows, strict=True))}}
    return {"names": names, "subjects": ["07", "16", "49"], "apart": ["16"], "values": values}


def test_windows_are_taken_from_the_first_file_and_means_leave_people_apart_out() -> None:
    first, later = file("depth", a=0.02, b=0.5, c=0.04), file("depth", a=0.9, b=0.9, c=0.9)
    made = tables(Found.read([first, later, file(OTHERS, a=0.1, b=0.1, c=0.1)]))
    depth, people = made["depth"].rows
    assert depth[0] == NAMES["depth"]
    assert (depth[1], depth[4]) == (3, 3.0)  # centimetres; 16 is in no mean
    assert people[4] == 10.0
    assert made["depth-by-subject"].rows[0] == [NAMES["depth"], 2.0, 50.0, 4.0]
    assert made["depth-warned"].rows[0] == ["all", 1, 1, 5, 0]


def test_mixtures_are_compared_with_their_parts_on_the_same_windows() -> None:
    files = [file("2D + depth", a=0.01, b=0.01, c=0.01), file("2D", a=0.03, b=0.9, c=0.03)]
    (row,) = tables(Found.read(files))["depth-compared"].rows
    assert row[0] == f"{NAMES['2D + depth']}: less {NAMES['2D']}"
    assert row[3] == -2.0
    assert row[1] is None  # nothing is known of what was seen


def test_refused_windows_count_nowhere() -> None:
    one = file("depth", a=0.02, b=0.5, c=0.04)
    one["values"]["depth"]["recon"]["49_01@0.00"] = {"refused": "too far"}
    assert tables(Found.read([one]))["depth"].rows[0][1] == 2

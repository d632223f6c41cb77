"""Unit and up axis: told by the file or the body, never guessed when ambiguous."""

from typing import get_args

import numpy as np
import pytest

from recon.core.coordinates import (
    corrected_up,
    decide_up,
    inferred_up,
    reason_for_declared_unit,
    unit_from_bones,
    unit_from_markers,
    vectors_up_body,
)
from recon.core.units import (
    METRES,
    Up,
    check_unit,
    parse_unit,
    snapped_rate,
    to_z_up,
)


@pytest.mark.parametrize("unit", list(METRES))
@pytest.mark.parametrize("length", [1.05, 1.4, 1.75, 2.15])
def test_every_unit_is_recognised_by_the_length_of_the_body(unit: str, length: float) -> None:
    assert unit_from_bones(length / METRES[unit], "clip")[0] == unit


@pytest.mark.parametrize("length", [0.5, 3.0, 5000.0, 0.0])
def test_a_length_of_no_body_is_refused_and_names_the_option(length: float) -> None:
    with pytest.raises(ValueError, match="--unit"):
        unit_from_bones(length, "clip")


@pytest.mark.parametrize(("extent", "unit"), [(1.6, "m"), (160.0, "cm"), (1600.0, "mm")])
def test_markers_tell_metric_units_apart(extent: float, unit: str) -> None:
    assert unit_from_markers(extent, "clip")[0] == unit


def test_markers_between_two_units_are_refused() -> None:
    with pytest.raises(ValueError, match="--unit"):
        unit_from_markers(10.0, "clip")


def test_a_declared_unit_that_makes_a_dwarf_is_refused() -> None:
    with pytest.raises(ValueError, match="--unit"):
        reason_for_declared_unit("mm", 1.7, "clip")
    assert "stated" in reason_for_declared_unit("mm", 1700.0, "clip")


def test_a_declared_unit_that_makes_a_child_of_a_hands_size_is_refused() -> None:
    """A person of 0.16 m was read without a word, as a single knee of that size is."""
    said = r"body's size is 0\.158 m, but an adult's in cm \(--unit cm\)"
    for names in (["Ann:LASI", "Ann:LTOE"], ["LFHD", "heel"], ["head", "RPSI"]):
        with pytest.raises(ValueError, match=said):
            reason_for_declared_unit("mm", 158.0, "clip", names)
    for names in (["knee1", "knee2"], ["LTOE", "LHEE", "HeadOfFoot"], ["RWRA", "RFIN"]):
        assert "stated" in reason_for_declared_unit("mm", 158.0, "clip", names)


def test_an_unknown_unit_is_refused_with_the_known_ones() -> None:
    for word in ("furlong", "0", "-1", "nan", "inf", ""):
        with pytest.raises(ValueError, match="inch"):
            check_unit(word)
    check_unit("0.3048")
    assert METRES["0.3048"] == 0.3048
    assert parse_unit(" Millimeters ") == "mm"
    assert parse_unit("") is None


@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_turning_to_z_up_is_a_proper_rotation_that_lifts_the_axis(up: str) -> None:
    turn = to_z_up(up)  # type: ignore[arg-type]
    assert np.linalg.det(turn) == pytest.approx(1.0)
    assert np.array_equal(turn @ np.eye(3)["xyz".index(up)], [0, 0, 1])


def test_an_upright_body_decides_even_against_the_files_hint() -> None:
    assert decide_up(np.array([0.1, 0.2, 1.4]), "y", "clip")[0] == "z"


@pytest.mark.parametrize("up", get_args(Up))
def test_feet_that_stand_tell_each_of_six_directions(up: Up) -> None:
    """Markers whose vertical axis points down were laid on the side."""
    heights = np.linspace(0.0, 0.1, 9)
    walker = np.zeros((9, 2, 3))
    walker[:, :, 0], walker[:, 0, 2] = 10 * heights[:, None], 1.6 + heights
    names, seen = ("Head", "LeftToeBase"), np.ones((9, 2), dtype=bool)
    for usual in (None, "y", "z"):
        assert inferred_up(names, walker @ to_z_up(up), seen, usual, "clip")[0] == up


def test_who_stands_on_the_hands_leaves_it_to_the_custom_of_the_format() -> None:
    swing = np.linspace(-0.2, 0.2, 9)
    acrobat = np.zeros((9, 3, 3))
    acrobat[:, :, 2] = np.stack([np.full(9, 0.3), 1.7 + swing, np.zeros(9)], -1)
    seen, names = np.ones((9, 3), dtype=bool), ("Head", "LeftToeBase", "Hand")
    assert inferred_up(names, acrobat, seen, "z", "clip")[0] == "z"
    assert inferred_up(names, acrobat, seen, None, "clip")[0] == "z-down"


def test_a_lying_body_leaves_it_to_the_custom_of_the_format() -> None:
    assert decide_up(np.array([0.8, 0.7, 0.1]), "y", "clip")[0] == "y"


@pytest.mark.parametrize("rise", [None, np.array([0.8, 0.7, 0.1])])
def test_an_ambiguous_axis_is_refused_and_names_the_option(rise: np.ndarray | None) -> None:
    with pytest.raises(ValueError, match="--up"):
        decide_up(rise, None, "clip")


def test_head_and_feet_are_found_among_the_names_of_many_systems() -> None:
    systems = [
        ("Head", "LeftToeBase"), ("head", "left_ankle"), ("mixamorig:Head", "mixamorig:LeftFoot"),
        ("Nick01:LFHD", "Nick01:LHEL"), ("R.Acromium", "R.Toe.Tip"), ("R_Shoulder", "r_calc"),
        ("CV7", "L_FCC"), ("MAN", "RP5MT"), ("R.ASIS", "R.MT1"), ("LACR", "LCAL"),
    ]  # fmt: skip
    positions = np.array([[[0.0, 1.6, 0.0], [0.0, 0.1, 0.0]]])
    for names in systems:
        rise = vectors_up_body(names, positions, np.ones((1, 2), dtype=bool))
        assert len(rise) == 1, names
        assert np.allclose(rise.mean(0), [0, 1.5, 0]), names


def dancer(raised: bool) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Names, positions (one frame, z up) and what is seen of a dancer with hidden legs."""
    places = {
        "head": (0.1, 0.0, 1.6), "neck": (0.05, 0.0, 1.45), "pelvis": (0.0, 0.0, 1.0),
        "left_ankle": (-0.8, 0.0, 1.2), "left_foot": (-0.9, 0.0, 1.3),
        "right_ankle": (0.0, 0.0, 0.1), "right_foot": (0.1, 0.0, 0.0),
    }  # fmt: skip
    hidden = [not name.startswith("left" if raised else "h") and "_" in name for name in places]
    return list(places), np.array([[*places.values()]]), ~np.array([hidden])


def test_a_raised_foot_whose_fellow_is_hidden_tells_nothing_of_the_up_axis() -> None:
    """The vector from it to the head told that the person stands along x: the file was refused."""
    names, positions, visible = dancer(raised=True)
    rise = vectors_up_body(names, positions, visible)
    assert len(rise) == 1
    assert decide_up(rise.mean(0), "z", "clip")[0] == "z"
    assert corrected_up("z", names, positions, visible) is None


@pytest.mark.parametrize("raised", [True, False])
@pytest.mark.parametrize("up", ["x", "y", "x-down", "y-down", "z-down"])
def test_a_trunk_tells_that_a_file_says_the_wrong_axis(up: Up, raised: bool) -> None:
    names, positions, visible = dancer(raised)
    assert corrected_up("z", names, positions @ to_z_up(up), visible) == up


def test_a_slanted_body_leaves_the_axis_to_what_the_file_says() -> None:
    """It was refused, though nothing contradicted the file."""
    names, positions, visible = dancer(raised=False)
    turn = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]) + np.eye(3)
    assert corrected_up("z", names, positions @ turn, visible) is None


def test_somebody_who_bends_with_hidden_legs_tells_nothing_of_the_up_axis() -> None:
    """Such files were refused: "z is up by the file, but the body stands along x-down"."""
    names, upright, visible = dancer(raised=False)
    angle = np.radians([20.0, 80.0, 95.0, 95.0, 95.0])
    turn = np.zeros((5, 3, 3))
    turn[:, 0, 0], turn[:, 0, 2], turn[:, 1, 1] = np.cos(angle), np.sin(angle), 1.0
    turn[:, 2, 0], turn[:, 2, 2] = -np.sin(angle), np.cos(angle)
    pelvis = upright[:, [names.index("pelvis")]]
    bent = (upright - pelvis) @ turn.swapaxes(1, 2) + pelvis
    assert corrected_up("z", names, bent, visible.repeat(5, 0)) is None
    lying = bent[[-1] * 5]
    assert corrected_up("z", names, lying, visible.repeat(5, 0)) == "x"


def test_rates_hidden_by_rounding_are_whole() -> None:
    assert snapped_rate(1 / 0.0083333) == 120
    assert snapped_rate(29.97) == 29.97

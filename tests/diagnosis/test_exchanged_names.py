"""Exchanged names of keypoints are exchanged back where that is sure, and right names are kept."""

import pytest
import torch

from tests.diagnosis.test_views import FRAMES, NAMES, SIDES, filmed, renamed, screened


@pytest.mark.parametrize(("count", "first", "last"), [(1, 8, 17), (3, 8, 17), (1, 0, 9)])
def test_sides_exchanged_in_a_stretch_are_put_right(count: int, first: int, last: int) -> None:
    """Left and right exchanged for a third of a clip passed without a word and 6.8 cm of error."""
    views = filmed(count)
    k = min(1, count - 1)
    spoilt = list(views)
    spoilt[k] = renamed(views[k], slice(first, last + 1), SIDES)
    out, repairs, warnings = screened(tuple(spoilt))
    assert [(f.code, f.frames) for f in repairs] == [("sides exchanged", ((first, last),))]
    assert NAMES[k] in repairs[0].message
    assert warnings == []
    assert torch.equal(out[k].pixels, views[k].pixels)


def test_right_names_before_an_exchange_that_begins_without_a_jump_are_kept() -> None:
    """Where names went over in some frames and jumped back, right ones were exchanged."""
    (one,) = filmed(1)
    other = renamed(one, slice(None), SIDES)
    share = ((torch.arange(FRAMES) - 8) / 6).clamp(0, 1).where(torch.arange(FRAMES) < 22, 0.0)
    spoilt = one.replace(pixels=torch.lerp(one.pixels, other.pixels, share[:, None, None]))
    (out,), repairs, warnings = screened((spoilt,))
    assert repairs == []
    assert [f.code for f in warnings] == ["sides exchanged", "identity change"]
    assert out is spoilt


@pytest.mark.parametrize("limb", [("knee", "ankle", "toe", "heel"), ("wrist", "elbow")])
@pytest.mark.parametrize("frames", [1, 2])
def test_limbs_that_collapse_for_a_moment_keep_their_names(limb: tuple[str], frames: int) -> None:
    """All frames before were exchanged: from the middle, paths led to the counterparts."""
    (one,) = filmed(1)
    other = renamed(one, slice(None), [pair for pair in SIDES if pair[0].endswith(limb)])
    share = torch.zeros(FRAMES)
    share[12 : 12 + frames] = 0.45
    spoilt = one.replace(pixels=torch.lerp(one.pixels, other.pixels, share[:, None, None]))
    (out,), repairs, _ = screened((spoilt,))
    assert [f.code for f in repairs if "exchanged" in f.code] == []
    assert torch.equal(out.pixels[0, :12], one.pixels[0, :12])


@pytest.mark.parametrize("rows", [(1,), (0, 1, 2)])
def test_sides_exchanged_throughout_are_exchanged_back(rows: tuple[int, ...]) -> None:
    """Rays tell which view has them exchanged; noses, knees and toes tell if all views have."""
    views = filmed(3)
    spoilt = [renamed(v, slice(None), SIDES) if k in rows else v for k, v in enumerate(views)]
    out, repairs, _ = screened(tuple(spoilt))
    assert [(f.code, f.frames) for f in repairs] == [("sides exchanged", ())]
    assert all(torch.equal(a.pixels, b.pixels) for a, b in zip(out, views, strict=True))


@pytest.mark.parametrize("right", [slice(0, 0), slice(8, 18)])
def test_sides_of_one_view_are_told_by_the_body_that_fits_better(right: slice) -> None:
    """A network that names most frames wrongly wins every vote of the frames."""
    (one,) = filmed(1)
    spoilt = renamed(renamed(one, slice(None), SIDES), right, SIDES)
    (out,), repairs, warnings = screened((spoilt,))
    assert [f.code for f in repairs] == ["sides exchanged"]
    assert warnings == []
    assert torch.equal(out.pixels, one.pixels)


def test_sides_of_two_views_are_told_by_the_body_that_their_rays_make() -> None:
    views = filmed(2)
    out, repairs, _ = screened((views[0], renamed(views[1], slice(None), SIDES)))
    assert [f.code for f in repairs] == ["sides exchanged"]
    assert torch.equal(out[1].pixels, views[1].pixels)


@pytest.mark.parametrize("frames", [slice(8, 14), slice(5, 28), slice(None)])
def test_wrist_and_elbow_are_given_back_their_names(frames: slice) -> None:
    """A stretch by its two jumps, which part is wrong, and a whole clip, by the upper arm."""
    (one,) = filmed(1)
    pair = [("left_wrist", "left_elbow")]
    (out,), repairs, _ = screened((renamed(one, frames, pair),))
    assert [f.code for f in repairs] == ["points exchanged"]
    assert set(repairs[0].joints) == set(pair[0])
    assert torch.equal(out.pixels, one.pixels)

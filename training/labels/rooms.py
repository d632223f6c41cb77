"""Random rooms for simulated depth: furniture, floor, walls and the sensor's position."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int

from recon.core.camera import Camera, pose_looking_at
from recon.core.raster import rasterise
from recon.simulation.depth import DepthSensor, PixelSurface, measured_depth
from recon.simulation.points import sampled_on_surface
from recon.simulation.scenery import FurnitureMesh, box, chair, joined_meshes, table

SIZE = (256, 212)
"""Width and height of the depth images, pixels."""
_FOCAL = 182.0
_ELSEWHERE = 1000.0
"""Stands for the place on the body of what is furniture."""
_FLIES, _NOISE = 0.04, 3.5
"""A point so many metres behind or before its surface, and more than so many standard deviations
of the noise, belongs to none."""


@dataclass(frozen=True)
class LabelledPoints:
    """Points of one depth image of a person, and their true labels."""

    points: Float[np.ndarray, "points 3"]
    """World frame, metres."""
    places: Float[np.ndarray, "points 3"]
    """Place on the unposed average body, metres; zero off the body."""
    on_body: Int[np.ndarray, " points"]
    """1 on the body, 0 elsewhere and in the air."""


@dataclass(frozen=True)
class Room:
    """A sensor and what surrounds a person."""

    camera: Camera
    sensor: DepthSensor
    furniture: FurnitureMesh
    wall: float
    """Distance of a wall behind the person from the sensor, metres; it faces the sensor."""
    correlated_noise: float
    """Standard deviation of the noise that neighbouring pixels share, metres."""

    @property
    def eye(self) -> Float[np.ndarray, "3"]:
        """Place of the sensor, metres."""
        return self.camera.T_world_camera[:3, 3].double().numpy()


def drawn_room(
    vertices: Float[np.ndarray, "moments vertices 3"], random: np.random.Generator
) -> Room:
    """Draw a random room with sensor and furniture around a person, metres, floor at z = 0."""
    low, high = vertices.min((0, 1)), vertices.max((0, 1))
    middle = np.median(vertices[len(vertices) // 2], 0)
    angle, away = random.uniform(0, 2 * np.pi), random.uniform(1.3, 4.5)
    eye = middle + away * np.array([np.cos(angle), np.sin(angle), 0.0])
    eye[2] = max(random.uniform(0.3, 2.3), 0.15)
    target = middle + random.normal(0.0, 0.12, 3)
    # zoom so that near people fit into the image in about half of the windows
    zoom = random.uniform(0.8, 1.15) * min(away / 2.2, 1.6)
    matrix = [[zoom * _FOCAL, 0, SIZE[0] / 2], [0, zoom * _FOCAL, SIZE[1] / 2], [0, 0, 1]]
    camera = Camera.create(
        np.array(matrix),
        SIZE,
        T_camera_world=pose_looking_at(torch.tensor(eye), torch.tensor(target)),
    )
    sensor = DepthSensor(
        constant=random.uniform(0.0005, 0.005),
        quadratic=0.0019 * random.uniform(0.3, 2.5),
        lost=random.uniform(0.2, 0.9),
        flying=random.uniform(0.0, 0.4),
    )
    pieces: list[FurnitureMesh] = []
    if random.random() < 0.45:
        count = int(random.integers(1, 4))
        pieces = [_random_furniture(middle, high[2] - low[2], random) for _ in range(count)]
    seat = float(np.median(vertices[..., 2]) - 0.12)
    if 0.3 < seat < 0.7 and random.random() < 0.4:
        under = chair(height=seat, width=random.uniform(0.38, 0.6))
        pieces.append(under.placed((*middle[:2], 0.0), random.uniform(0, 2 * np.pi)))
    return Room(
        camera=camera,
        sensor=sensor,
        furniture=joined_meshes(pieces),
        wall=away + random.uniform(0.4, 3.0),
        correlated_noise=random.choice([0.0, 0.003, 0.01]) * random.random(),
    )


def simulated_room_points(
    vertices: Float[np.ndarray, "vertices 3"],
    faces: Int[np.ndarray, "faces 3"],
    places: Float[np.ndarray, "vertices 3"],
    room: Room,
    background: str,
    random: np.random.Generator,
) -> LabelledPoints:
    """Simulate the points that a room's sensor measures of a person and of things nearby.

    Args:
        vertices: of the person, metres.
        faces: of the person.
        places: of the vertices on the unposed average body, metres.
        room: where it happens.
        background: beside the body: `nothing`, what lies in a `ball` about one of its points, or
            what lies in a `box` about the body.
        random: source of chance.
    """
    depth, seen, surface = _rendered_image(vertices, faces, places, room)
    noisy = measured_depth(depth, room.camera, room.sensor, random)
    noisy = np.where(noisy > 0, noisy + room.correlated_noise * _correlated_noise(random), 0.0)
    row, column = np.nonzero(noisy)
    true, found = depth[row, column], noisy[row, column]
    here = surface[row, column]
    points = _world_points(room.camera, row, column, found)
    noise = np.hypot(room.sensor.deviation(true), room.correlated_noise)
    body = (here == PixelSurface.BODY) & (
        np.abs(found - true) < np.maximum(_FLIES, _NOISE * noise)
    )
    kept = here == PixelSurface.BODY
    on = np.flatnonzero(body)
    if len(on) == 0:
        return LabelledPoints(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, np.int64))
    if background == "ball":
        centre = points[on[random.integers(len(on))]]
        near = np.linalg.norm(points - centre, axis=1) < random.uniform(0.15, 0.7)
        kept = kept | near
    elif background == "box":
        low, high = points[on].min(0), points[on].max(0)
        margin = random.uniform(0.02, 0.4, 3)
        near = ((points > low - margin) & (points < high + margin)).all(1)
        if random.random() < 0.6:
            near &= (here != PixelSurface.GROUND) | (points[:, 2] > random.uniform(0.01, 0.04))
        kept = kept | near
    kept = np.flatnonzero(kept)
    others = kept[~body[kept]]
    most = int(random.uniform(0.05, 0.8) * len(on)) + 1
    if len(others) > most:
        others = random.permutation(others)[:most]
    kept = np.concatenate([on, others])
    shown = np.where(body[kept, None], seen[row[kept], column[kept]], 0.0)
    return LabelledPoints(points[kept], shown, body[kept].astype(np.int64))


def body_points(
    vertices: Float[np.ndarray, "vertices 3"],
    faces: Int[np.ndarray, "faces 3"],
    places: Float[np.ndarray, "vertices 3"],
    count: int,
    random: np.random.Generator,
) -> LabelledPoints:
    """Draw `count` points all over a person's surface, with noise and a few stray points."""
    drawn = sampled_on_surface(vertices, faces, count, random, np.hstack([vertices, places]))
    noise = random.uniform(0.001, 0.01)
    points, shown = drawn[:, :3] + random.normal(0.0, noise, (count, 3)), drawn[:, 3:]
    on_body = (random.random(count) >= random.choice([0.0, 0.0, 0.03])).astype(np.int64)
    wild = random.uniform(vertices.min(0) - 0.1, vertices.max(0) + 0.1, (count, 3))
    points = np.where(on_body[:, None] > 0, points, wild)
    return LabelledPoints(points, shown * on_body[:, None], on_body)


def _rendered_image(vertices: np.ndarray, faces: np.ndarray, places: np.ndarray, room: Room):
    """Depth (0 without a surface), place on the body and kind of surface of all pixels."""
    camera, mesh = room.camera, room.furniture
    every = np.concatenate([vertices, mesh.vertices])
    T = camera.T_camera_world.double().numpy()
    local = every @ T[:3, :3].T + T[:3, 3]
    K = camera.camera_matrix.double().numpy()
    z = local[:, 2]
    pixels = local[:, :2] / np.maximum(z, 1e-3)[:, None] * K[0, 0] + K[:2, 2]
    triangles = np.concatenate([faces, mesh.faces + len(vertices)])
    triangles = triangles[(z > 0.1)[triangles].all(1)]
    values = np.concatenate([places, np.full_like(mesh.vertices, _ELSEWHERE)])
    raster = rasterise(pixels, z, triangles, SIZE, values)
    seen = raster.values
    surface = np.where(seen[..., 0] > 0.5 * _ELSEWHERE, PixelSurface.BOX, PixelSurface.BODY)
    row, column = np.indices(raster.depth.shape).reshape(2, -1)
    rays = _world_points(camera, row, column, np.ones(len(row))) - room.eye
    floor = -room.eye[2] / np.where(np.abs(rays[:, 2]) < 1e-9, 1e-9, rays[:, 2])
    floor = np.where(floor > 0.1, floor, np.inf).reshape(raster.depth.shape)
    depth = np.minimum(np.minimum(raster.depth, floor), room.wall)
    surface = np.where(depth < raster.depth, PixelSurface.GROUND, surface)
    return depth.astype(np.float64), seen, surface


def _world_points(
    camera: Camera, row: np.ndarray, column: np.ndarray, depth: np.ndarray
) -> np.ndarray:
    """Unproject pixels with given depths to the world, metres."""
    K = camera.camera_matrix.double().numpy()
    T = camera.T_camera_world.double().numpy()
    rays = np.stack([(column + 0.5 - K[0, 2]), (row + 0.5 - K[1, 2])], 1) / K[0, 0]
    local = np.concatenate([rays, np.ones_like(rays[:, :1])], 1) * depth[:, None]
    return (local - T[:3, 3]) @ T[:3, :3]


def _correlated_noise(random: np.random.Generator) -> Float[np.ndarray, "height width"]:
    """Spatially correlated noise with a range of about ten pixels."""
    import cv2

    coarse = random.standard_normal((SIZE[1] // 10, SIZE[0] // 10)).astype(np.float32)
    return cv2.resize(coarse, SIZE, interpolation=cv2.INTER_CUBIC)


def _random_furniture(
    middle: np.ndarray, height: float, random: np.random.Generator
) -> FurnitureMesh:
    """Draw a chair, table, box or board that stands near a person."""
    angle, away = random.uniform(0, 2 * np.pi), random.uniform(0.3, 1.3)
    place = middle + away * np.array([np.cos(angle), np.sin(angle), 0.0])
    heading = random.uniform(0, 2 * np.pi)
    match int(random.integers(4)):
        case 0:
            piece = chair(random.uniform(0.38, 0.5), random.uniform(0.4, 0.5))
        case 1:
            piece = table(random.uniform(0.6, 1.6), random.uniform(0.5, 0.9))
        case 2:
            piece = box(random.uniform(0.1, 0.8, 3).tolist())
        case _:
            # a board, or a corner of a wall, hides part of the person
            size = (random.uniform(0.1, 1.0), 0.05, random.uniform(0.3, max(height, 0.5)))
            piece = box(size, random.choice([0.0, random.uniform(0, 1.0)]))
    return piece.placed((*place[:2], 0.0), heading)

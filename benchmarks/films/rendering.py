"""Renders films of known truth: our body in random clothes and a random room.

Colours are functions of the unposed body's surface: a face with eyes, brows and mouth, hair, a
shirt, trousers and shoes, each of drawn colours with patterns and folds. The room is a box whose
floor, walls and ceiling are pictures of noise with windows, doors and boards, so that it has
vertical edges and a floor; a lamp shades the body, and its shadow lies on the floor.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8

from recon import BodyModel, Camera
from recon.core.raster import rasterise, vertex_normals
from recon.simulation.scenery import clothed

PIXELS_M = 80
"""Resolution of the room's pictures (pixels per metre)."""
LIGHT = (1.0, 0.86, 0.93, 0.8, 0.9, 1.0)
"""Brightness of the six sides of the room, relative to the brightest."""
Picture = UInt8[np.ndarray, "height width 3"]


def noise(
    rng: np.random.Generator, size: tuple[int, int], roughness: float = 0.6
) -> Float[np.ndarray, "height width"]:
    """Return random clouds of several sizes, of mean 0 and standard deviation 1."""
    width, height = size
    total, share, cells = np.zeros((height, width), np.float32), 1.0, 3
    while cells < max(size) / 2:
        coarse = rng.standard_normal((cells * height // width + 2, cells)).astype(np.float32)
        total += share * cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
        share, cells = share * roughness, cells * 3
    return (total - total.mean()) / total.std()


def colour(rng: np.random.Generator, dull: float, light: tuple[float, float]) -> np.ndarray:
    """Draw a random colour (RGB, 0 to 255) of a given dullness and range of lightness."""
    hue = rng.uniform(0, 255, 3)
    grey = rng.uniform(*light) * 255
    return np.clip(grey + (hue - hue.mean()) * (1 - dull), 5, 250).astype(np.float32)


@dataclass(frozen=True)
class Room:
    """A box around the origin with a picture on each of its six sides."""

    low: np.ndarray
    high: np.ndarray
    """Upper corner (m); `low` is the lower one."""
    pictures: tuple[np.ndarray, ...]
    """Pictures of the sides x low, x high, y low, y high, floor, ceiling; float32."""

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach: float) -> "Room":
        """Draw a random room whose walls are at least `reach` metres from the middle."""
        walls = reach + rng.uniform(0.3, 4.0, 4)
        high = np.array([walls[0], walls[1], rng.uniform(2.6, 4.5)])
        low = np.array([-walls[2], -walls[3], 0.0])
        size = high - low
        wall, pictures = colour(rng, 0.7, (0.45, 0.9)), []
        for side in range(6):
            spans = [size[k] for k in range(3) if k != side // 2]
            shape = (round(spans[0] * PIXELS_M), round(spans[1] * PIXELS_M))
            plain = wall if side < 4 else colour(rng, 0.7, ((0.2, 0.7), (0.75, 0.95))[side - 4])
            picture = plain * (1 + 0.08 * noise(rng, shape, 0.8)[..., None])
            if side < 4:
                _furnish(picture, rng)
            elif side == 4:
                _lay(picture, rng)
            pictures.append(np.clip(picture, 0, 255).astype(np.float32))
        return cls(low.astype(np.float32), high.astype(np.float32), tuple(pictures))

    def seen(self, camera: Camera) -> Float[np.ndarray, "height width 3"]:
        """Render the room from a camera inside (one pose), at half its images' resolution."""
        width, height = (side // 2 for side in camera.image_size)
        T = camera.T_world_camera.numpy()
        inverse = np.linalg.inv(camera.camera_matrix.numpy())
        u, v = np.meshgrid(2 * np.arange(width) + 1, 2 * np.arange(height) + 1)
        pixels = np.stack([u, v, np.ones_like(u)], -1).astype(np.float32)
        ways = pixels @ (T[:3, :3] @ inverse).T
        eye = np.clip(T[:3, 3], self.low + 0.05, self.high - 0.05)
        walls = np.where(ways > 0, self.high, self.low)
        with np.errstate(divide="ignore"):
            far = (walls - eye) / np.where(ways == 0, 1e-9, ways)
        axis, out = far.argmin(-1), np.zeros((height, width, 3), np.float32)
        hit = eye + far.min(-1, keepdims=True) * ways
        for side, picture in enumerate(self.pictures):
            k = side // 2
            mask = (axis == k) & ((ways[..., k] > 0) == bool(side % 2))
            if not mask.any():
                continue
            a, b = (j for j in range(3) if j != k)
            x = (hit[..., a] - self.low[a]) * PIXELS_M
            y = (self.high[b] - hit[..., b]) * PIXELS_M
            drawn = cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            out[mask] = LIGHT[side] * drawn[mask]
        return cv2.resize(out, camera.image_size)


def _furnish(wall: np.ndarray, rng: np.random.Generator) -> None:
    """Draw windows, doors, boards and cupboards with vertical sides, and a skirting board."""
    height, width = wall.shape[:2]
    for _ in range(rng.integers(3, 7)):
        w, h = (rng.uniform(0.5, 1.6) * PIXELS_M, rng.uniform(0.4, 1.1) * PIXELS_M)
        x, y = rng.uniform(0, width - w), rng.uniform(0.08, 0.35) * height
        if rng.random() < 0.5:  # a door or cupboard, which reaches down to the floor
            y, h = 0.25 * height, height
        first, last = (int(x), int(y)), (int(x + w), min(int(y + h), height))
        cv2.rectangle(wall, first, last, colour(rng, 0.5, (0.1, 0.95)).tolist(), -1)
        cv2.rectangle(wall, first, last, colour(rng, 0.9, (0.1, 0.9)).tolist(), 4)
        for part in range(1, rng.integers(1, 4)):
            at = int(x + part * w / 3)
            cv2.line(wall, (at, first[1]), (at, last[1]), (60, 60, 60), 2)
    cv2.rectangle(wall, (0, height - 8), (width, height), (90, 80, 70), -1)


def _lay(floor: np.ndarray, rng: np.random.Generator) -> None:
    """Draw boards or tiles on the floor."""
    step, dark = int(rng.uniform(0.15, 0.7) * PIXELS_M), 0.75
    floor[::step] *= dark
    floor[1::step] *= dark
    if rng.random() < 0.6:
        floor[:, :: step * int(rng.integers(1, 6))] *= dark


@dataclass(frozen=True)
class Clothes:
    """Colours of a person by the place on the unposed average body (y up, z forward, metres)."""

    shirt: np.ndarray
    trousers: np.ndarray
    shoes: np.ndarray
    skin: np.ndarray
    hair: np.ndarray
    sleeve: float
    """Distance (m) from the middle at which sleeves end."""
    leg: float
    """Height (m) at which trousers end."""
    stripes: float
    """Stripes of the shirt per metre; 0 for none."""
    grain: Float[np.ndarray, "cells cells"]

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "Clothes":
        """Draw random clothes, skin and hair."""
        tone = rng.uniform(0.25, 1.0)
        skin = np.array([235, 195, 170], np.float32) * tone + np.array([20, 8, 0], np.float32)
        hair = np.array([150, 110, 70], np.float32) * rng.uniform(0.15, 1.1)
        return cls(
            colour(rng, 0.2, (0.15, 0.9)), colour(rng, 0.5, (0.1, 0.6)),
            colour(rng, 0.6, (0.05, 0.9)), skin, hair, rng.choice([0.30, 0.42, 0.64]),
            rng.choice([-0.66, -1.10, -1.12]), rng.choice([0.0, 0.0, 12.0, 25.0]),
            noise(rng, (512, 512), 0.75),
        )  # fmt: skip

    def at(self, places: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "points 3"]:
        """Return the colours of points of the unposed surface."""
        x, y, z = np.abs(places[:, 0]), places[:, 1], places[:, 2]
        out = np.repeat(self.skin[None], len(places), 0)
        cells = (places[:, :2] * 300 + z[:, None] * 170).astype(int) % 512
        grain = self.grain[cells[:, 1], cells[:, 0]][:, None]
        body, head = y < 0.27, (y > 0.24) & (x < 0.12)
        shirt = body & (x < self.sleeve) & (y > -0.25)
        stripes = 1 + 0.35 * np.sign(np.sin(2 * np.pi * self.stripes * y))[:, None]
        out[shirt] = (self.shirt * stripes)[shirt] * (1 + 0.07 * grain[shirt])
        trousers = (y <= -0.25) & (y > self.leg) & (x < 0.35)
        out[trousers] = self.trousers * (1 + 0.09 * grain[trousers])
        out[(y < -1.135) & (x < 0.35)] = self.shoes
        out[(y < -1.205) & (x < 0.35)] = 230
        out[np.abs(y + 0.25) < 0.015] *= 0.5  # a belt
        face = head & (z > 0.03)
        top = 0.42
        out[head & (y > 0.33) & ((z < 0.045) | (y > top + 0.02))] = self.hair
        for height, deep, colours, wide in (
            (0.395, 0.007, (245, 245, 240), 0.015), (0.395, 0.006, (40, 30, 25), 0.006),
            (0.412, 0.004, self.hair, 0.019),
        ):  # fmt: skip
            out[face & (np.abs(y - height) < deep) & (np.abs(x - 0.031) < wide)] = colours
        out[face & (np.abs(y - 0.318) < 0.007) & (x < 0.025)] = self.skin * (0.75, 0.45, 0.45)
        out[face & (np.abs(y - 0.343) < 0.005) & (np.abs(x - 0.010) < 0.006)] *= 0.6
        return out


@dataclass(frozen=True)
class Actor:
    """A person who is filmed: the body with the surface of its clothes, and their colours."""

    body: BodyModel
    """Body model with the surface of clothes."""
    clothes: Clothes

    @classmethod
    def drawn(cls, body: BodyModel, seed: int) -> "Actor":
        """Draw random clothes for a body."""
        return cls(clothed(body, seed), Clothes.drawn(np.random.default_rng([seed, 1])))


@dataclass(frozen=True)
class Set:
    """A room and the direction of the lamp in it."""

    room: Room
    lamp: Float[np.ndarray, "3"]

    @classmethod
    def drawn(cls, seed: int, reach: float) -> "Set":
        """Draw a random room with walls at least `reach` metres from the middle, and a lamp."""
        rng = np.random.default_rng([seed, 2])
        side = rng.uniform(-0.7, 0.7, 2)
        return cls(Room.drawn(rng, reach), np.array([*side, 1.0]) / np.hypot(1, np.hypot(*side)))


def render(
    scene: Set, camera: Camera, actors: list[tuple[Actor, np.ndarray]], rng: np.random.Generator
) -> Picture:
    """Render one frame of people in a room.

    Args:
        scene: room and lamp.
        camera: camera with one pose.
        actors: people with the vertices of their skin in the world.
        rng: random generator of the image noise.
    """
    image = scene.room.seen(camera)
    width, height = camera.image_size
    nearest = np.full((height, width), np.inf, np.float32)
    shadow = np.zeros((height // 2, width // 2), np.uint8)
    for actor, vertices in actors:
        ground = vertices - vertices[:, 2:] * (scene.lamp / scene.lamp[2])
        pixels, depth = _projected(camera, ground)
        bones = actor.body.weights.argmax(-1).numpy()
        for bone in range(bones.max() + 1 if depth.min() > 0.1 else 0):
            part = (pixels[bones == bone] * 8).astype(np.int32)
            cv2.fillConvexPoly(shadow, cv2.convexHull(part), 255, cv2.LINE_8, 4)
    soft = cv2.GaussianBlur(shadow, (0, 0), 0.003 * width)
    image *= 1 - cv2.resize(soft, (width, height)).astype(np.float32)[..., None] * (0.45 / 255)
    for actor, vertices in actors:
        faces = actor.body.faces.numpy()
        pixels, depth = _projected(camera, vertices)
        if depth.min() < 0.1:
            continue
        rest = actor.body.template.numpy()
        raster = rasterise(pixels, depth, faces, (width, height), rest)
        normals = vertex_normals(vertices, faces)
        turned = rasterise(pixels, depth, faces, (width, height), normals).values
        seen = raster.covered & (raster.depth < nearest)
        nearest[seen] = raster.depth[seen]
        light = 0.55 + 0.5 * np.clip(turned[seen] @ scene.lamp, -0.4, 1)
        image[seen] = actor.clothes.at(raster.values[seen]) * light[:, None]
    image = cv2.GaussianBlur(image, (5, 5), 0.7)
    image += 2.5 * rng.standard_normal(image.shape, np.float32)
    return cv2.convertScaleAbs(np.maximum(image, 0))


def _projected(camera: Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    found = camera.project(torch.from_numpy(points).to(camera.camera_matrix))
    return found.pixels.numpy(), found.depth.numpy()

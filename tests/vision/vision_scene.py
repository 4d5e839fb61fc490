"""A small ray-cast room: panoramas with exact truth for the tests of the camera front-end."""

from dataclasses import dataclass, field

import cv2
import numpy as np

from homeward.vision.features.patch_alignment import align_patches, similarity

PER_M = 60
"""Texture pixels per metre."""


@dataclass
class Room:
    """An empty room with posters on its walls and a few boxes on its floor."""

    size: tuple[float, float, float]
    faces: list[tuple[int, float, np.ndarray]] = field(default_factory=list)
    boxes: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = field(default_factory=list)


def texture(rng: np.random.Generator, width: float, height: float, posters: int) -> np.ndarray:
    """Return a plain wall of `width` by `height` [m] with random posters on it."""
    shape = max(int(height * PER_M), 8), max(int(width * PER_M), 8)
    base = rng.uniform(110, 190)
    wall = base + cv2.resize(rng.normal(0, 6, (6, 8)).astype(np.float32), shape[::-1])
    for _ in range(posters):
        size = rng.uniform(0.25, 0.9, 2) * PER_M
        h, w = np.minimum(size, np.array(shape) - 2).astype(int)
        top, left = rng.integers(0, shape[0] - h), rng.integers(0, shape[1] - w)
        cells = rng.uniform(20, 240, tuple(rng.integers(3, 8, 2))).astype(np.float32)
        mode = cv2.INTER_NEAREST if rng.random() < 0.5 else cv2.INTER_CUBIC
        wall[top : top + h, left : left + w] = cv2.resize(
            cells, (int(w), int(h)), interpolation=mode
        )
    return np.clip(wall, 0, 255).astype(np.float32)


def make_room(
    seed: int, size: tuple[float, float, float] = (8.0, 6.0, 2.8), boxes: int = 4
) -> Room:
    """Return a sparse room drawn from `seed`."""
    rng = np.random.default_rng(seed)
    room = Room(size)
    for axis in range(3):
        others = [size[i] for i in range(3) if i != axis]
        for at in (0.0, size[axis]):
            posters = 6 if axis < 2 else (0 if at == 0 else 4)
            room.faces.append((axis, at, texture(rng, *others, posters)))
    for _ in range(boxes):
        low = np.array([rng.uniform(0.3, size[0] - 1.2), rng.uniform(0.3, size[1] - 1.2), 0.0])
        high = low + rng.uniform([0.3, 0.3, 0.5], [0.9, 0.9, 1.6])
        room.boxes.append((low, high, texture(rng, 2.0, 2.0, 5)))
    return room


def sample(image: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Look up a texture at `u`, `v` [m]."""
    u, v = ((a * PER_M).astype(np.float32) for a in (u, v))
    return cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)


def hit(room: Room, eye: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return grey value and distance of what the rays `d` (h, w, 3) from `eye` meet."""
    far = np.full(d.shape[:2], np.inf)
    grey = np.zeros(d.shape[:2], np.float32)
    with np.errstate(divide="ignore", invalid="ignore"):
        for axis, at, image in room.faces:
            s = (at - eye[axis]) / d[..., axis]
            p = eye + s[..., None] * d
            u, v = (p[..., i] for i in range(3) if i != axis)
            near = (s > 0) & (s < far)
            far = np.where(near, s, far)
            grey = np.where(near, sample(image, u, v), grey)
        for low, high, image in room.boxes:
            a, b = (low - eye) / d, (high - eye) / d
            enter, leave = np.minimum(a, b), np.maximum(a, b)
            side, s = enter.argmax(-1), enter.max(-1)
            near = (s > 0) & (s < leave.min(-1)) & (s < far)
            p = eye + np.where(near, s, 0)[..., None] * d - low
            u = np.where(side == 0, p[..., 1] + 0.3, p[..., 0])
            v = np.where(side == 2, p[..., 1], p[..., 2])
            far, grey = np.where(near, s, far), np.where(near, sample(image, u, v), grey)
    return grey, far


def rays(width: int, height: int, tilt: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """Return unit rays (height, width, 3) of an equirectangular camera, square pixels."""
    step = 2 * np.pi / width
    azimuth = (width / 2 - 0.5 - np.arange(width)) * step
    elevation = (height / 2 - 0.5 - np.arange(height)) * step
    e, a = np.meshgrid(elevation, azimuth, indexing="ij")
    r = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], -1)
    roll, pitch = tilt
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    return r @ (about_y @ about_x).T


def look(
    room: Room,
    x: float,
    y: float,
    heading: float,
    width: int = 512,
    height: int = 128,
    z: float = 1.0,
    tilt: tuple[float, float] = (0.0, 0.0),
    noise: float = 2.0,
    seed: int = 0,
) -> np.ndarray:
    """Return the grey panorama (height, width) seen from a pose in the room."""
    c, s = np.cos(heading), np.sin(heading)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    grey, _ = hit(room, np.array([x, y, z]), rays(width, height, tilt) @ turn.T)
    image = cv2.GaussianBlur(grey, (0, 0), 0.6)
    image = image + np.random.default_rng(seed).normal(0, noise, image.shape)
    return np.clip(image, 0, 255).astype(np.uint8)


def write_pictures(folder, pictures, period, under=""):
    """Write numbered pictures, `period` [s] apart, and the images.csv that lists them."""
    rows = ["t,file"]
    for k, picture in enumerate(pictures):
        cv2.imwrite(str(folder / under / f"{k}.png"), picture)
        rows.append(f"{period * k},{under}{k}.png")
    (folder / "images.csv").write_text("\n".join(rows) + "\n")


def align_features(home, now, at_home, at_now, size, growth, turn):
    """Align patches about features, (n, 2), with those of their matches, grown and turned."""
    return align_patches(home, now, at_home, size, similarity(at_now, growth, turn))

"""Flat things drawn exactly as a lens shows them: each part of a pixel is traced to the plane."""

import json
from functools import cache

import cv2
import numpy as np

from homeward.drives.cameras.camera import angles, unit_vectors
from homeward.drives.cameras.lens import Lens
from homeward.vision.tags.front_end import family_of

PARTS = 3


@cache
def rays_of(json_lens, shape):
    """Rays (n, 3) of parts of pixels of a lens, given as JSON."""
    lens = Lens.model_validate(json.loads(json_lens))
    rows, columns = ((np.arange(n * PARTS) + 0.5) / PARTS - 0.5 for n in shape)
    u, v = np.meshgrid(columns, rows)
    return unit_vectors(*lens.directions(u.ravel(), v.ravel(), shape))


def picture(lens, shape, sheet, corner, right, up, noise=2.0, seed=0, paper=150, blur=0.6):
    """A picture, uint8, of a sheet (grey, upright) in space.

    `corner` is its lower left one, `right` and `up` its sides, all (3,) in the camera's frame
    (x ahead, y left, z up) [m].
    """
    height, width = shape
    share = np.linspace(0, 1, 30)[:, None]
    sides = [corner + share * right, corner + share * up]
    edge = np.concatenate([*sides, sides[0] + up, sides[1] + right])
    outline = np.stack(lens.pixels(*angles(edge), shape), axis=1)
    # Around the sheet is paper.
    first = np.clip(np.floor(outline.min(axis=0)) - 1, 0, [width, height]).astype(int) * PARTS
    last = np.clip(np.ceil(outline.max(axis=0)) + 2, 0, [width, height]).astype(int) * PARTS
    there = slice(first[1], last[1]), slice(first[0], last[0])
    every = rays_of(lens.model_dump_json(), shape).reshape(height * PARTS, width * PARTS, 3)
    rays = every[there]
    normal = np.cross(right, up)
    with np.errstate(divide="ignore", invalid="ignore"):
        way = (corner @ normal) / (rays @ normal)
        place = rays * way[..., None] - corner
        a, b = place @ right / (right @ right), place @ up / (up @ up)
    h, w = sheet.shape
    x, y = a * w - 0.5, (1 - b) * h - 0.5
    met = (way > 0) & (a >= 0) & (a <= 1) & (b >= 0) & (b <= 1)
    x, y = (np.where(met, c, -9).astype(np.float32) for c in (x, y))
    fine = np.full(every.shape[:2], float(paper))
    part = cv2.remap(sheet.astype(np.float32), x, y, cv2.INTER_NEAREST)
    fine[there] = np.where(met, part, paper)
    grey = fine.reshape(height, PARTS, width, PARTS).mean(axis=(1, 3))
    if blur:
        grey = cv2.GaussianBlur(grey, (0, 0), blur)
    grain = noise * np.random.default_rng(seed).standard_normal(shape)
    return np.clip(30 + 0.75 * grey + grain, 0, 255).astype(np.uint8)


def tag(number, family="36h11", fine=30):
    """A tag with a white border one cell wide."""
    dictionary = family_of(family)
    cells = dictionary.markerSize + 2
    code = cv2.aruco.generateImageMarker(dictionary, number, cells * fine)
    return np.pad(code, fine, constant_values=255)


def placed(middle, size, yaw=0.0, pitch=0.0, roll=0.0):
    """Corner, right and up of a sheet that faces the camera, turned [rad]; size (w, h) [m]."""
    (cy, sy), (cp, sp), (cr, sr) = ((np.cos(a), np.sin(a)) for a in (yaw, pitch, roll))
    turn = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]]) @ np.array(
        [[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]]
    )
    right = turn @ np.array([0, -cr, sr]) * size[0]
    up = turn @ np.array([0, sr, cr]) * size[1]
    return np.asarray(middle) - right / 2 - up / 2, right, up

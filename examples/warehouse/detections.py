"""Tags in view of the robot's camera: in rendered images, or simulated with their errors.

`python -m examples.warehouse.detections` compares both at random poses: the share of tags that are
detected, and the errors of their corners, by the length of their shortest side in the image.
"""

from __future__ import annotations

import math
import sys
from itertools import pairwise

import mujoco
import numpy as np

from examples.warehouse.world import FAMILY, TAG, World
from homeward.drives.cameras.camera import tag_bearings
from homeward.drives.cameras.lens import Lens
from homeward.vision.tags.front_end import TagBearings, TagFrontEnd, Tags

SIZE = 800, 360
"""Columns and rows of the camera's images, a region of its sensor [px]."""
FOCAL = 400.0
"""Focal length [px]: 90 degrees wide."""
LENS = Lens(fx=FOCAL, fy=FOCAL, cx=(SIZE[0] - 1) / 2, cy=(SIZE[1] - 1) / 2)
GREY_NOISE = 2.5
"""Standard deviation of the camera's noise [grey levels]."""


class Camera:
    """The forward camera: rendered images with noise, and the tags that OpenCV finds in them."""

    def __init__(self, world: World, seed: int = 0) -> None:
        self._world, self._rng = world, np.random.default_rng([seed, 2])
        world.robots[0].camera.fovy[:] = math.degrees(2 * math.atan(SIZE[1] / 2 / FOCAL))
        self._renderer = mujoco.Renderer(world.model, SIZE[1], SIZE[0])
        self._renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
        self._front_end = TagFrontEnd(LENS, FAMILY)
        self.image = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
        """The last image, RGB."""

    def see(self) -> TagBearings:
        """Take an image and return the tags in it."""
        self._renderer.update_scene(self._world.data, "front")
        clean = self._renderer.render()
        noise = self._rng.normal(0.0, GREY_NOISE, clean.shape[:2]).astype(np.float32)
        self.image = np.clip(clean + noise[..., None] + 0.5, 0, 255).astype(np.uint8)
        return self._front_end.see(self.image[..., ::-1])

    def close(self) -> None:
        """Free the renderer."""
        self._renderer.close()


SIDE_PX = np.array([8.0, 9.5, 12.5, 16.0, 21.0, 29.0, 41.0, 55.0])
"""Shortest side of a tag in the image [px], for the next tables, which `compare` measured."""
DETECTED = np.array([0.0, 0.01, 0.39, 0.83, 0.98, 0.97, 0.98, 0.94])
"""Share of the tags in view that are detected."""
ERROR_PX = np.array([0.12, 0.12, 0.10, 0.09, 0.066, 0.053, 0.026, 0.029])
"""Standard deviation of a corner's coordinates [px]."""
REPORTED_PX = np.array([0.05, 0.048, 0.033, 0.032, 0.031, 0.031, 0.031, 0.032])
"""The standard deviation that the front end reports, which is too small for small tags [px]."""


class Simulated:
    """The same camera without images: tags in view, with the errors measured on the images."""

    def __init__(self, world: World, seed: int = 0, robot: int = 0) -> None:
        self._world, self._robot = world, robot
        self._rng = np.random.default_rng([seed, 3] + [robot] * (robot > 0))

    def see(self) -> TagBearings:
        """Return the tags in view now."""
        names, corners = corners_in_view(self._world, self._robot)
        side = _shortest(corners)
        found = self._rng.random(len(names)) < np.interp(side, SIDE_PX, DETECTED)
        corners, side = corners[found], side[found]
        error, sigma = (np.interp(side, SIDE_PX, table) for table in (ERROR_PX, REPORTED_PX))
        corners = corners + self._rng.standard_normal(corners.shape) * error[:, None, None]
        names = tuple(name for name, one in zip(names, found, strict=True) if one)
        bearing, deviation = tag_bearings(corners, sigma, LENS, (SIZE[1], SIZE[0]))
        return TagBearings(
            dict(zip(names, bearing.tolist(), strict=True)),
            dict(zip(names, deviation.tolist(), strict=True)),
            Tags(names, corners, sigma),
        )


def corners_in_view(world: World, robot: int = 0) -> tuple[list[str], np.ndarray]:
    """Return ids and true corners (n, 4, 2) [px] of the tags that a robot sees."""
    names, at, normals = world.tags()
    camera = world.robots[robot].camera.id
    eye, axes = world.data.cam_xpos[camera], world.data.cam_xmat[camera].reshape(3, 3)
    right = np.stack([-normals[:, 1], normals[:, 0], np.zeros(len(at))], axis=-1)[:, None]
    up = np.array([0.0, 0.0, 1.0])
    ways = np.array([(-1, 1), (1, 1), (1, -1), (-1, -1)]) * TAG / 2
    points = at[:, None] + ways[:, :1] * right + ways[:, 1:] * up
    sight = (points - eye) @ axes  # x to the right, y up, z backwards
    with np.errstate(divide="ignore", invalid="ignore"):
        columns = LENS.cx - FOCAL * sight[..., 0] / sight[..., 2]
        rows = LENS.cy + FOCAL * sight[..., 1] / sight[..., 2]
    corners = np.stack([columns, rows], axis=-1)
    inside = (corners > 2) & (corners < np.array(SIZE) - 3) & (sight[..., 2:] < -0.1)
    faces = np.sum((eye[:2] - at[:, :2]) * normals, axis=1) > 0
    rows_in = np.flatnonzero(inside.all(axis=(1, 2)) & faces & (_shortest(corners) > SIDE_PX[0]))
    if not len(rows_in):
        return [], np.empty((0, 4, 2))
    # Rays to the corners and the centre end on the tag, if nothing is in between.
    targets = np.concatenate([points[rows_in], at[rows_in][:, None]], axis=1).reshape(-1, 3) - eye
    far = np.linalg.norm(targets, axis=1)
    hit, distance = np.zeros(len(far), np.int32), np.zeros(len(far))
    rays, body = (targets / far[:, None]).ravel(), world.robots[robot].body
    mujoco.mj_multiRay(
        world.model, world.data, eye, rays, None, 1, body, hit, distance, None, len(far), 20.0
    )
    free = (np.abs(distance - far) < 0.03).reshape(-1, 5).all(axis=1)
    return [names[k] for k in rows_in[free]], corners[rows_in[free]]


def _shortest(corners: np.ndarray) -> np.ndarray:
    """Return the length of the shortest side of tags [px]."""
    with np.errstate(invalid="ignore"):
        return np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).min(axis=1)


def compare(frames: int, seed: int = 0) -> str:
    """Return a table of detections in rendered images against the true corners."""
    world, rng = World(seed), np.random.default_rng(seed)
    camera = Camera(world, seed)
    rows, false = [], 0
    for _ in range(frames):
        x, y = rng.uniform(1.2, 10.8), rng.choice([1.55, 4.0, 6.45]) + rng.uniform(-0.4, 0.4)
        world.robots[0].carry(x, y, rng.uniform(-math.pi, math.pi))
        world.data.time += 1.0
        world.advance(0.1)
        mujoco.mj_forward(world.model, world.data)
        names, corners = corners_in_view(world)
        tags = camera.see().tags
        false += len(set(tags.names) - {str(t) for box in world.present for t in box.tags})
        for name, true, side in zip(names, corners, _shortest(corners), strict=True):
            error = math.nan
            claimed = math.nan
            if name in tags.names:
                k = tags.names.index(name)
                error = float(np.sqrt(np.mean((tags.corners[k] - true) ** 2)))
                claimed = float(tags.sigma[k])
            rows.append((side, error, claimed))
    camera.close()
    side, error, claimed = np.array(rows).T
    lines = [f"{'side [px]':>10}{'tags':>7}{'detected':>10}{'error':>8}{'reported':>10} [px]"]
    for low, high in pairwise((8, 11, 14, 18, 24, 34, 48, 999)):
        use = (side >= low) & (side < high)
        if use.any():
            rms = math.sqrt(np.nanmean(error[use] ** 2)) if np.isfinite(error[use]).any() else 0
            reported = np.nanmedian(claimed[use]) if np.isfinite(claimed[use]).any() else 0
            lines.append(
                f"{low:6.0f} on {use.sum():7}{np.isfinite(error[use]).mean():10.2f}"
                f"{rms:8.3f}{reported:10.3f}"
            )
    return "\n".join([*lines, f"{frames} images, {false} detections of tags that are not there"])


if __name__ == "__main__":
    print(compare(int(sys.argv[1]) if len(sys.argv) > 1 else 200))

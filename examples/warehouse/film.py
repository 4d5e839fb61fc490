"""The film of a drive: the hall, the camera's image, and the map, rendered after the drive."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from examples.warehouse.detections import Camera
from examples.warehouse.robot import Moment, Robot
from examples.warehouse.world import LENGTH, RACK_DEPTH, RACK_X, RACKS, WIDTH, World
from homeward.estimator import Status
from homeward.geometry.frames import Pose, compose

EVERY_S = 0.5
"""Time from picture to picture [s]."""
FPS = 10
"""Pictures per second of the film, which is thus five times as fast as the drive."""
SIZE = 1200, 680
HALL = 760, 680
CAMERA = 440, 198
MAP = 440, 320
GIF_WIDTH, GIF_EVERY, GIF_COLOURS = 640, 6, 48
ENLARGED = 3
"""The ellipse of the position is drawn larger by this factor, since it is a few centimetres."""
INK, PAPER = (25, 30, 38), (246, 247, 249)
BLUE, VERMILLION, GREEN, GREY = (0, 114, 178), (213, 94, 0), (0, 158, 115), (150, 155, 162)
WORDS = {
    Status.LOCALISED: "localised",
    Status.COASTING: "coasting on odometry",
    Status.UNVERIFIED: "pose not verified yet",
    Status.MAPPING: "mapping",
    Status.WAITING: "no home yet",
}


@dataclass(frozen=True)
class Picture:
    """The state of everything at one time."""

    t: float
    qpos: np.ndarray
    mocap: tuple[np.ndarray, np.ndarray]
    lamps: np.ndarray
    camera: np.ndarray
    corners: np.ndarray
    answer: Moment | None
    landmarks: tuple[Any, ...]
    moved: dict[str, tuple[float, Pose, float]]
    named: frozenset[str]
    boxes: dict[str, tuple[float, float, float, tuple[float, float, float], float]]
    """x, y, yaw, half sizes, and height of each box."""
    path: list[tuple[float, float]]
    doing: str


class Film:
    """Pictures of a drive; `record` after each tick, then `write`."""

    def __init__(self, world: World, robot: Robot, camera: Camera, home: Pose) -> None:
        self._world, self._robot, self._camera, self._home = world, robot, camera, home
        self.pictures: list[Picture] = []
        self.reported: list[Any] = []
        """The outcomes that were reported already."""

    def record(self, moved: dict[str, tuple[float, Pose, float]], named: set[str]) -> None:
        """Keep the present state, if a picture is due."""
        world, robot = self._world, self._robot
        if world.t < len(self.pictures) * EVERY_S or robot.seen is None:
            return
        data = world.data
        boxes = {b.name: (b.x, b.y, b.yaw, b.half, b.z + b.half[2]) for b in world.present}
        path = [compose(self._home, p)[:2] for _, p in robot.truth[::25]]
        small = cv2.resize(self._camera.image, CAMERA, interpolation=cv2.INTER_AREA)
        self.pictures.append(
            Picture(
                world.t,
                data.qpos.copy(),
                (data.mocap_pos.copy(), data.mocap_quat.copy()),
                world.model.light_diffuse.copy(),
                small,
                robot.seen.tags.corners * CAMERA[0] / self._camera.image.shape[1],
                robot.answer,
                robot.landmarks,
                dict(moved),
                frozenset(named),
                boxes,
                path,
                robot.doing,
            )
        )

    def write(self, folder: Path) -> None:
        """Write film.mp4 and film.gif."""
        import imageio_ffmpeg

        folder.mkdir(parents=True, exist_ok=True)
        renderer = hall_renderer(self._world)
        writer = imageio_ffmpeg.write_frames(
            str(folder / "film.mp4"), SIZE, fps=FPS, codec="libx264", quality=7, macro_block_size=8
        )
        writer.send(None)
        small = []
        for k, picture in enumerate(self.pictures):
            frame = self.draw(picture, renderer)
            writer.send(np.ascontiguousarray(frame))
            if k % GIF_EVERY == 0 or k == len(self.pictures) - 1:
                height = round(GIF_WIDTH * SIZE[1] / SIZE[0])
                plain = frame.copy()  # without the texture of the floor, which costs most bytes
                plain[:, : HALL[0]] = cv2.medianBlur(np.ascontiguousarray(frame[:, : HALL[0]]), 5)
                small.append(cv2.resize(plain, (GIF_WIDTH, height), interpolation=cv2.INTER_AREA))
        for _ in range(2 * FPS):
            writer.send(np.ascontiguousarray(frame))
        writer.close()
        renderer.close()
        _write_gif(folder / "film.gif", small)

    def draw(self, picture: Picture, renderer: mujoco.Renderer) -> np.ndarray:
        """Return a picture of `SIZE`, RGB."""
        sheet = Image.new("RGB", SIZE, PAPER)
        sheet.paste(Image.fromarray(self._hall(picture, renderer)), (0, 0))
        view = picture.camera.copy()
        for corners in picture.corners:
            cv2.polylines(view, [np.round(corners * 8).astype(int)], True, (60, 255, 60), 2, 16, 3)
        sheet.paste(Image.fromarray(view), (HALL[0], 0))
        sheet.paste(Image.fromarray(self._map(picture)), (HALL[0], CAMERA[1]))
        self._words(ImageDraw.Draw(sheet), picture)
        return np.asarray(sheet)

    def _hall(self, picture: Picture, renderer: mujoco.Renderer) -> np.ndarray:
        world = self._world
        data, model = world.data, world.model
        data.qpos[:] = picture.qpos
        data.mocap_pos[:], data.mocap_quat[:] = picture.mocap
        model.light_diffuse[:] = picture.lamps
        mujoco.mj_forward(model, data)
        view = mujoco.MjvCamera()
        x, y = data.qpos[:2]
        view.lookat[:] = 0.8 * LENGTH / 2 + 0.2 * x, 0.8 * WIDTH / 2 + 0.2 * y, 0.0
        view.distance, view.elevation = 12.3, -72
        view.azimuth = 90 + 6 * math.sin(0.03 * picture.t)
        renderer.update_scene(data, view)
        for name, (_, old, low) in picture.moved.items():
            half = picture.boxes[name][3]
            _add_box(
                renderer.scene, (old.x, old.y, low + half[2]), half, old.heading, (1, 1, 1, 0.25)
            )
        for name in picture.named & picture.boxes.keys():
            x, y, yaw, half, z = picture.boxes[name]
            grown = tuple(h + 0.05 for h in half)
            _add_box(renderer.scene, (x, y, z), grown, yaw, (1.0, 0.3, 0.0, 0.45))
        return renderer.render()

    def _map(self, picture: Picture) -> np.ndarray:
        scale = 34.0
        left, top = (MAP[0] - LENGTH * scale) / 2, (MAP[1] - WIDTH * scale) / 2
        image = np.full((MAP[1], MAP[0], 3), 255, np.uint8)

        def at(x: float, y: float) -> tuple[int, int]:
            return round((left + x * scale) * 8), round((top + (WIDTH - y) * scale) * 8)

        def outline(corners: list[tuple[float, float]], colour: Any, width: int = 1) -> None:
            points = np.array([at(*c) for c in corners])
            cv2.polylines(image, [points], True, colour, width, cv2.LINE_AA, 3)

        outline([(0, 0), (LENGTH, 0), (LENGTH, WIDTH), (0, WIDTH)], INK, 2)
        for y in RACKS:
            low, high = y - RACK_DEPTH / 2, y + RACK_DEPTH / 2
            a, b = RACK_X
            outline([(a, low), (b, low), (b, high), (a, high)], (205, 209, 214))
        for name, (x, y, yaw, half, _) in picture.boxes.items():
            is_named = name in picture.named
            c, s = math.cos(yaw), math.sin(yaw)
            around = [(i * half[0], j * half[1]) for i, j in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
            corners = [(x + c * i - s * j, y + s * i + c * j) for i, j in around]
            outline(corners, VERMILLION if is_named else GREY, 2 if is_named else 1)
        for name, (_, old, _) in picture.moved.items():
            x, y, *_ = picture.boxes[name]
            tip, tail = np.array(at(x, y)) // 8, np.array(at(old.x, old.y)) // 8
            colour = VERMILLION if name in picture.named else GREY
            cv2.arrowedLine(image, tail, tip, colour, 1, cv2.LINE_AA, tipLength=0.08)
        for m in picture.landmarks:
            if m.x is not None and m.y is not None:
                x, y, _ = compose(self._home, Pose(m.x, m.y, 0.0))
                has_moved = m.moved_probability is not None and m.moved_probability > 0.5
                colour = VERMILLION if has_moved else BLUE
                cv2.circle(image, at(x, y), 16, colour, -1, cv2.LINE_AA, 3)
        path = np.array([at(*p) for p in picture.path])
        cv2.polylines(image, [path], False, GREEN, 1, cv2.LINE_AA, 3)
        cv2.drawMarker(
            image, tuple(np.array(at(*self._home[:2])) // 8), INK, cv2.MARKER_TILTED_CROSS, 10, 2
        )
        answer = picture.answer
        if answer is not None and answer.pose is not None and answer.covariance is not None:
            x, y, heading = compose(self._home, answer.pose)
            turn = np.array(
                [
                    [math.cos(self._home.heading), -math.sin(self._home.heading)],
                    [math.sin(self._home.heading), math.cos(self._home.heading)],
                ]
            )
            values, vectors = np.linalg.eigh(turn @ answer.covariance[:2, :2] @ turn.T)
            axes = np.minimum(3 * ENLARGED * scale * np.sqrt(values), 200.0)
            angle = -math.degrees(math.atan2(vectors[1, 1], vectors[0, 1]))
            size = round(axes[1] * 8), round(axes[0] * 8)
            cv2.ellipse(image, at(x, y), size, angle, 0, 360, BLUE, 2, cv2.LINE_AA, 3)
            nose = at(x + 0.45 * math.cos(heading), y + 0.45 * math.sin(heading))
            cv2.line(image, at(x, y), nose, BLUE, 3, cv2.LINE_AA, 3)
            cv2.circle(image, at(x, y), 40, BLUE, -1, cv2.LINE_AA, 3)
        return image

    def _words(self, draw: ImageDraw.ImageDraw, picture: Picture) -> None:
        x, y = HALL[0] + 16, CAMERA[1] + MAP[1] + 6
        answer = picture.answer
        status = "no home yet" if answer is None else WORDS[answer.status]
        draw.text((x, y), status, BLUE, _font(22))
        if answer is not None and answer.covariance is not None and not math.isnan(answer.error):
            sigma = 100 * math.sqrt(float(np.trace(answer.covariance[:2, :2]) / 2))
            text = f"true error {100 * answer.error:.1f} cm, reported sigma {sigma:.1f} cm"
            draw.text((x, y + 30), text, INK, _font(17))
        draw.text((x, y + 54), picture.doing[:52], INK, _font(15))
        moved, named = len(picture.moved), len(picture.named & picture.moved.keys())
        wrong = len(picture.named - picture.moved.keys())
        text = f"moved boxes: {moved}, named: {named}" + (f", wrongly: {wrong}" if wrong else "")
        draw.text((x, y + 76), text, VERMILLION, _font(17))
        key = f"dots: estimated tags. Ellipse: 3 sigma, {ENLARGED} x enlarged. Green: true path"
        draw.text((x, y + 104), key, GREY, _font(12))
        draw.text(
            (x, y + 122), f"{picture.t:.0f} s, film {FPS * EVERY_S:.0f} x as fast", GREY, _font(12)
        )
        draw.text(
            (HALL[0] + 10, CAMERA[1] - 22), "robot's camera, tags read", (255, 255, 255), _font(14)
        )


def hall_renderer(world: World) -> mujoco.Renderer:
    """Return a renderer of the hall; without shadows, which cost most of the time."""
    renderer = mujoco.Renderer(world.model, HALL[1], HALL[0])
    renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
    return renderer


def _font(size: int) -> Any:
    return ImageFont.load_default(size)


def _add_box(
    scene: mujoco.MjvScene, at: tuple[float, ...], half: tuple[float, ...], yaw: float, colour: Any
) -> None:
    c, s = math.cos(yaw), math.sin(yaw)
    mujoco.mjv_initGeom(
        scene.geoms[scene.ngeom],
        mujoco.mjtGeom.mjGEOM_BOX,
        np.array(half, float),
        np.array(at, float),
        np.array([c, -s, 0, s, c, 0, 0, 0, 1.0]),
        np.array(colour, np.float32),
    )
    scene.ngeom += 1


def _write_gif(path: Path, frames: list[np.ndarray]) -> None:
    images = [Image.fromarray(frame) for frame in frames]
    sample = Image.fromarray(np.concatenate(frames[:: max(len(frames) // 4, 1)]))
    colours = sample.quantize(GIF_COLOURS).getpalette()[: 3 * GIF_COLOURS]
    colours += [c for colour in (INK, PAPER, BLUE, VERMILLION, GREEN, GREY) for c in colour]
    palette = Image.new("P", (1, 1))
    palette.putpalette(colours + colours[:3] * (256 - len(colours) // 3))
    plain = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    times = [150] * (len(plain) - 1) + [2500]
    plain[0].save(path, save_all=True, append_images=plain[1:], duration=times, loop=0)

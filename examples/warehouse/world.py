"""A warehouse in MuJoCo: racks, boxes with AprilTags, people, lamps, and a robot on two wheels.

Hall coordinates: x and y from the south-west corner, z up [m]. Everything follows from the seed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import cv2
import mujoco
import numpy as np

from examples.warehouse.vehicle import Start, Vehicle, part, robot_xml

LENGTH, WIDTH, HEIGHT = 12.0, 8.0, 3.0
"""Of the hall, along x, y and z [m]."""
TAG = 0.2
"""Side of a tag's black square [m]."""
SHEET = TAG * 10 / 8
"""Side of its paper, with a white border of one cell [m]."""
FAMILY = "36h11"
STEP_S = 0.002
"""Step of the physics [s]."""
RACKS = (2.7, 5.3)
"""y of the two racks, which run along x from `RACK_X[0]` to `RACK_X[1]` [m]."""
RACK_X, RACK_DEPTH = (3.0, 9.0), 0.9
SHELVES = 0.18, 0.9
"""Heights of the shelves for boxes with tags [m]."""


class Slot(NamedTuple):
    """A position where a box may stand."""

    x: float
    y: float
    z: float
    """Height of the floor or shelf [m]."""
    yaw: float


@dataclass
class Box:
    """A box with a tag on each of its four sides."""

    name: str
    tags: tuple[int, int, int, int]
    """Ids of the tags in front (+x of the box), left, behind and right."""
    slot: int | None
    """Index of its slot; None: it is not in the hall."""
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    """Height of its underside [m]."""
    yaw: float = 0.0
    half: tuple[float, float, float] = (0.2, 0.2, 0.2)
    """Half of its length, width and height [m]."""


@dataclass
class Person:
    """Someone who walks to and fro along a line of points."""

    path: np.ndarray
    """(n, 2) [m]"""
    speed: float
    at: float = 0.0
    """Distance along the path [m]."""
    direction: float = 1.0
    length: float = field(init=False)

    def __post_init__(self) -> None:
        self._ends = np.cumsum([0.0, *np.hypot(*np.diff(self.path, axis=0).T)])
        self.length = float(self._ends[-1])

    @property
    def position(self) -> tuple[float, float]:
        x, y = (float(np.interp(self.at, self._ends, axis)) for axis in self.path.T)
        return x, y

    def walk(self, dt: float, robots: list[tuple[float, float]]) -> None:
        """Walk for `dt` [s], and turn round in front of a robot."""
        before = [math.dist(self.position, robot) for robot in robots]
        self.at = float(np.clip(self.at + self.direction * self.speed * dt, 0.0, self.length))
        approaches = any(
            far < 1.3 and math.dist(self.position, robot) < far
            for robot, far in zip(robots, before, strict=True)
        )
        if approaches or self.at in (0.0, self.length):
            self.direction = -self.direction


def slots() -> list[Slot]:
    """Return the positions for boxes: on both sides of the racks, and along the walls."""
    found = []
    for y in RACKS:
        for side in (-1.0, 1.0):
            for x in np.linspace(RACK_X[0] + 0.45, RACK_X[1] - 0.45, 6):
                found += [Slot(float(x), y + side * 0.22, z, side * math.pi / 2) for z in SHELVES]
    for x in np.linspace(1.6, 10.4, 8):
        found += [Slot(float(x), 0.32, 0.0, math.pi / 2), Slot(float(x), WIDTH - 0.32, 0.0, -1.57)]
    for y in np.linspace(1.0, WIDTH - 1.0, 6):
        found += [Slot(0.32, float(y), 0.0, 0.0), Slot(LENGTH - 0.32, float(y), 0.0, math.pi)]
    return found


class World:
    """The hall with everything in it.

    Parameters
    ----------
    seed : int
        Seed of the boxes, people, colours and lamps.
    boxes : int
        Number of boxes in the hall.
    spare : int
        Number of boxes outside the hall, for `arrive`.
    people : int
        Number of people, at most 3.
    starts : tuple
        x, y [m] and heading [rad] of each robot.
    """

    def __init__(
        self,
        seed: int = 0,
        boxes: int = 56,
        spare: int = 0,
        people: int = 2,
        starts: tuple[Start, ...] = ((1.5, 4.0, 0.0),),
    ) -> None:
        self.rng = np.random.default_rng([seed, 1])
        self.slots = slots()
        if boxes >= len(self.slots):
            raise ValueError(f"{boxes} boxes, but only {len(self.slots)} slots; leave some free")
        self.boxes = [self._box(k) for k in range(boxes + spare)]
        paths = (
            [(2.3, 3.45), (9.7, 3.45), (9.7, 4.6), (2.3, 4.6)],
            [(10.9, 1.2), (10.9, 6.8)],
            [(9.5, 7.0), (2.5, 7.0)],
        )
        self.people = [
            Person(np.array(path), float(self.rng.uniform(0.6, 1.0)), float(self.rng.uniform(0, 5)))
            for path in paths[:people]
        ]
        self.model = mujoco.MjModel.from_xml_string(*self._mjcf(starts))
        self.data = mujoco.MjData(self.model)
        self.robots = [Vehicle(self.model, self.data, k) for k in range(len(starts))]
        self._lamps = self.model.light_diffuse.copy()
        self._phase = self.rng.uniform(0, math.tau, len(self._lamps))
        for box, slot in zip(self.boxes[:boxes], self._free()[:boxes], strict=True):
            self.put(box, slot)
        for box in self.boxes[boxes:]:
            self.remove(box)
        self._pose_people()
        mujoco.mj_forward(self.model, self.data)

    # Boxes.

    def _box(self, k: int) -> Box:
        half = tuple(float(self.rng.uniform(*r)) for r in ((0.17, 0.24), (0.15, 0.2), (0.14, 0.24)))
        return Box(f"B{k + 1:02d}", (4 * k, 4 * k + 1, 4 * k + 2, 4 * k + 3), None, half=half)

    def _free(self) -> list[int]:
        """Return the free slots in random order."""
        used = {box.slot for box in self.boxes}
        free = [k for k in range(len(self.slots)) if k not in used]
        return [free[k] for k in self.rng.permutation(len(free))]

    def put(self, box: Box, slot: int) -> None:
        """Put a box into a slot, not quite straight."""
        at = self.slots[slot]
        dx, dy, turn = self.rng.uniform(-1, 1, 3) * (0.06, 0.03, 0.12)
        c, s = math.cos(at.yaw), math.sin(at.yaw)
        self.place(box, at.x + c * dy - s * dx, at.y + s * dy + c * dx, at.z, at.yaw + turn)
        box.slot = slot

    def place(self, box: Box, x: float, y: float, z: float, yaw: float) -> None:
        """Put a box anywhere."""
        box.x, box.y, box.z, box.yaw, box.slot = float(x), float(y), z, float(yaw), None
        body = self.model.body(box.name).mocapid[0]
        self.data.mocap_pos[body] = box.x, box.y, box.z + box.half[2]
        self.data.mocap_quat[body] = math.cos(yaw / 2), 0, 0, math.sin(yaw / 2)

    def remove(self, box: Box) -> None:
        """Take a box out of the hall."""
        self.place(box, -5.0, 0.7 * self.boxes.index(box), 0.0, 0.0)

    @property
    def present(self) -> list[Box]:
        """The boxes in the hall."""
        return [box for box in self.boxes if box.x > 0]

    def move(self, box: Box) -> None:
        """Move a box to a free slot at least 0.5 m away, with its tags."""
        far = [k for k in self._free() if math.dist(self.slots[k][:2], (box.x, box.y)) > 0.5]
        self.put(box, far[0])

    def arrive(self, box: Box) -> None:
        """Put a box from outside into a free slot."""
        self.put(box, self._free()[0])

    def tags(self) -> tuple[list[str], np.ndarray, np.ndarray]:
        """Return ids, positions (n, 3) [m] and outward normals (n, 2) of all tags in the hall."""
        boxes = self.present
        yaw = np.array([box.yaw for box in boxes])[:, None] + np.arange(4) * math.pi / 2
        normals = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
        middle = np.array([(box.x, box.y, box.z + box.half[2]) for box in boxes])
        half = np.array([[box.half[k % 2] for k in range(4)] for box in boxes]) + 0.004
        at = np.repeat(middle[:, None], 4, axis=1)
        at[..., :2] += half[..., None] * normals
        names = [str(tag) for box in boxes for tag in box.tags]
        return names, at.reshape(-1, 3), normals.reshape(-1, 2)

    @property
    def together(self) -> tuple[tuple[str, ...], ...]:
        """The tags of each box, as `together` in drive.yaml."""
        return tuple(tuple(map(str, box.tags)) for box in self.boxes)

    # Time.

    @property
    def t(self) -> float:
        """Time [s]."""
        return float(self.data.time)

    def advance(self, dt: float) -> None:
        """Let `dt` [s] pass."""
        for person in self.people:
            person.walk(dt, [robot.pose[:2] for robot in self.robots])
        self._pose_people()
        wave = 0.8 + 0.25 * np.sin(0.15 * self.t + self._phase)
        self.model.light_diffuse[:] = self._lamps * wave[:, None]
        for _ in range(round(dt / STEP_S)):
            mujoco.mj_step(self.model, self.data)

    def _pose_people(self) -> None:
        for k, person in enumerate(self.people):
            body = self.model.body(f"person{k}").mocapid[0]
            self.data.mocap_pos[body] = *person.position, 0.0

    # MJCF.

    def _mjcf(self, starts: tuple[Start, ...]) -> tuple[str, dict[str, bytes]]:
        """Return the model as MJCF, and its pictures."""
        pictures = {"floor.png": _png(self._floor())}
        assets, bodies = [], []
        dictionary = cv2.aruco.getPredefinedDictionary(
            getattr(cv2.aruco, f"DICT_APRILTAG_{FAMILY}")
        )
        for box in self.boxes:
            for tag in box.tags:
                black = cv2.aruco.generateImageMarker(dictionary, tag, 128)
                sheet = cv2.copyMakeBorder(black, 16, 16, 16, 16, cv2.BORDER_CONSTANT, value=255)
                pictures[f"tag{tag}.png"] = _png(sheet)
                assets.append(
                    f'<texture name="tag{tag}" type="2d" file="tag{tag}.png"/>'
                    f'<material name="tag{tag}" texture="tag{tag}" specular="0" texrepeat="1 1"/>'
                )
            bodies.append(self._box_xml(box))
        bodies += [self._person_xml(k) for k in range(len(self.people))]
        lamps = "".join(
            f'<light pos="{x} {y} {HEIGHT}" dir="0 0 -1" diffuse=".42 .42 .4" specular="0 0 0"'
            f' cutoff="85" exponent="1" attenuation="1 0 0.02" castshadow="{shadow}"/>'
            for x, y, shadow in ((2.0, 4.0, "false"), (6.0, 4.0, "true"), (10.0, 4.0, "false"))
        )
        motors = "\n".join(
            f'<velocity name="{wheel}" joint="{wheel}" kv="10" forcerange="-5 5"/>'
            for k in range(len(starts))
            for wheel in (part("left", k), part("right", k))
        )
        text = f"""
<mujoco model="warehouse">
  <compiler angle="radian"/>
  <option timestep="{STEP_S}" integrator="implicitfast" cone="elliptic" impratio="10"/>
  <visual>
    <global offwidth="1280" offheight="960"/>
    <quality shadowsize="2048" offsamples="4"/>
    <headlight ambient=".38 .38 .38" diffuse=".22 .22 .22" specular="0 0 0"/>
    <map znear="0.004" zfar="4"/>
  </visual>
  <asset>
    <texture name="floor" type="2d" file="floor.png"/>
    <material name="floor" texture="floor" texrepeat="6 4" specular="0.1"/>
    <texture name="sky" type="skybox" builtin="flat" rgb1=".72 .76 .8" width="16" height="16"/>
    {"".join(assets)}
  </asset>
  <worldbody>
    {lamps}
    <geom name="floor" type="plane" pos="{LENGTH / 2} {WIDTH / 2} 0"
      size="{LENGTH / 2} {WIDTH / 2} .1" material="floor" friction=".7 .005 .0001"/>
    {self._hall_xml()}
    {"".join(bodies)}
    {"".join(robot_xml(starts, k) for k in range(len(starts)))}
  </worldbody>
  <actuator>
    {motors}
  </actuator>
</mujoco>"""
        return text, pictures

    def _floor(self) -> np.ndarray:
        """Return a concrete floor tile of 2 m."""
        noise = np.zeros((256, 256))
        for size in (4, 16, 64, 256):
            grid = self.rng.standard_normal((size, size))
            noise += cv2.resize(np.pad(grid, 0), (256, 256), interpolation=cv2.INTER_CUBIC)
        grey = np.clip(128 + 7 * noise, 0, 255)
        grey[:2] = grey[:, :2] = 95
        return np.stack([grey * 0.97, grey, grey * 1.02], axis=-1).clip(0, 255).astype(np.uint8)

    def _hall_xml(self) -> str:
        found = []
        walls = (
            ("south", LENGTH / 2, -0.05, LENGTH / 2, 0.05),
            ("north", LENGTH / 2, WIDTH + 0.05, LENGTH / 2, 0.05),
            ("west", -0.05, WIDTH / 2, 0.05, WIDTH / 2),
            ("east", LENGTH + 0.05, WIDTH / 2, 0.05, WIDTH / 2),
        )
        for name, x, y, hx, hy in walls:  # low, so that the film sees over them
            found.append(
                f'<geom name="{name} wall" type="box" pos="{x} {y} .6" size="{hx} {hy} .6"'
                ' rgba=".83 .85 .87 1"/>'
            )
        middle, half = sum(RACK_X) / 2, (RACK_X[1] - RACK_X[0]) / 2
        for r, y in enumerate(RACKS):
            for level, z in enumerate((*SHELVES, 1.62)):
                found.append(
                    f'<geom name="rack {r} shelf {level}" type="box" pos="{middle} {y} {z - 0.02}"'
                    f' size="{half} {RACK_DEPTH / 2} .02" rgba=".85 .45 .12 1"/>'
                )
            for k, x in enumerate(np.linspace(*RACK_X, 4)):
                found += [
                    f'<geom name="rack {r} post {k} {side}" type="box" size=".03 .03 1.0"'
                    f' pos="{x} {y + side * (RACK_DEPTH / 2 - 0.03)} 1.0" rgba=".12 .25 .5 1"/>'
                    for side in (-1, 1)
                ]
            for x in np.arange(RACK_X[0] + 0.5, RACK_X[1] - 0.2, 1.0):  # pallets, without tags
                if self.rng.random() < 0.7:
                    a, b, h = self.rng.uniform((0.25, 0.25, 0.1), (0.4, 0.38, 0.25))
                    red, green, blue = self.rng.uniform((0.45, 0.35, 0.2), (0.75, 0.6, 0.5))
                    found.append(
                        f'<geom type="box" pos="{x} {y} {1.62 + h}" size="{a} {b} {h}" contype="0"'
                        f' conaffinity="0" rgba="{red:.2f} {green:.2f} {blue:.2f} 1"/>'
                    )
        return "\n".join(found)

    def _box_xml(self, box: Box) -> str:
        brown = self.rng.uniform(0.85, 1.1)
        sides = []
        for k, tag in enumerate(box.tags):
            angle = k * math.pi / 2
            off = box.half[k % 2] + 0.002
            x, y = off * math.cos(angle), off * math.sin(angle)
            # The picture is on the z side of its geom, which is turned to look outwards.
            right, up = (-math.sin(angle), math.cos(angle), 0), (0, 0, 1)
            axes = " ".join(f"{v:.6f}" for v in (*right, *up))
            sides.append(
                f'<geom type="box" size="{SHEET / 2} {SHEET / 2} .002" pos="{x} {y} 0"'
                f' xyaxes="{axes}" material="tag{tag}" contype="0" conaffinity="0"/>'
            )
        a, b, c = box.half
        return (
            f'<body name="{box.name}" mocap="true"><geom type="box" size="{a} {b} {c}"'
            f' rgba="{0.62 * brown:.2f} {0.47 * brown:.2f} {0.3 * brown:.2f} 1"/>'
            f"{''.join(sides)}</body>\n"
        )

    def _person_xml(self, k: int) -> str:
        red, green, blue = ((0.9, 0.75, 0.1), (0.2, 0.6, 0.75), (0.8, 0.3, 0.3))[k]
        return (
            f'<body name="person{k}" mocap="true">'
            '<geom type="capsule" fromto="0 -.09 .1 0 -.09 .8" size=".08" rgba=".2 .22 .3 1"/>'
            '<geom type="capsule" fromto="0 .09 .1 0 .09 .8" size=".08" rgba=".2 .22 .3 1"/>'
            '<geom type="capsule" fromto="0 0 .95 0 0 1.3" size=".19"'
            f' rgba="{red} {green} {blue} 1"/>'
            '<geom type="sphere" pos="0 0 1.62" size=".12" rgba=".85 .65 .5 1"/></body>\n'
        )


def _png(image: np.ndarray) -> bytes:
    return cv2.imencode(".png", image)[1].tobytes()

"""A robot on two wheels in MuJoCo: its mechanics, and its true pose."""

from __future__ import annotations

import math

import mujoco

Start = tuple[float, float, float]
"""x, y [m] and heading [rad]."""
RADIUS, TRACK = 0.1, 0.4
"""Nominal wheel radius and distance between the wheels [m]; the real wheels differ a little."""
WORN = 1.004, 0.998
"""Real radius of the left and the right wheel, as a share of the nominal one."""
ROTOR = 0.05
"""Inertia of a motor behind its gear [kg m^2]. Much less, and the physics, which makes the motor's
torque implicit after the friction of the floor, would turn the robot further than its wheels."""
CAMERA_X, CAMERA_Z = 0.2, 0.45
"""Position of the camera on the robot [m]; it looks ahead."""


def part(name: str, number: int) -> str:
    """Return the name of a part of a robot in the model; the first robot has plain names."""
    return f"{name} {number + 1}" if number else name


class Vehicle:
    """A robot in the hall, by its number."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, number: int = 0) -> None:
        self._model, self._data, self._number = model, data, number
        self.name = part("robot", number)
        self.body = model.body(self.name).id
        self.camera = model.camera(part("front", number))

    @property
    def pose(self) -> tuple[float, float, float]:
        """True x, y [m] and heading [rad] of the robot."""
        x, y, _, w, i, j, k = self._data.joint(part("base", self._number)).qpos.tolist()
        return x, y, math.atan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))

    @property
    def wheel_angles(self) -> tuple[float, float]:
        """Angles of the left and the right wheel [rad]."""
        left, right = (
            float(self._data.joint(part(side, self._number)).qpos[0]) for side in ("left", "right")
        )
        return left, right

    def turn_wheels(self, left: float, right: float) -> None:
        """Set the angular velocities that the motors aim at [rad/s]."""
        for side, rate in (("left", left), ("right", right)):
            self._data.actuator(part(side, self._number)).ctrl[0] = rate

    def carry(self, x: float, y: float, heading: float) -> None:
        """Carry the robot elsewhere (kidnapped robot); its encoders do not notice."""
        base = self._data.joint(part("base", self._number))
        base.qpos[:] = x, y, RADIUS, math.cos(heading / 2), 0, 0, math.sin(heading / 2)
        base.qvel[:] = 0
        mujoco.mj_forward(self._model, self._data)

    def touches(self) -> set[str]:
        """Return the names of the things that the robot touches, except the floor."""
        model, pairs = self._model, self._data.contact.geom
        mine = model.body_rootid[model.geom_bodyid[pairs]] == self.body
        found = set()
        for pair, (first, second) in zip(pairs, mine, strict=True):
            geom = model.geom(int(pair[0] if second else pair[1]))
            if first != second and geom.name != "floor":
                body = model.body(geom.bodyid[0])
                found.add(body.name if body.id else geom.name)
        return found


def robot_xml(starts: tuple[Start, ...], number: int) -> str:
    """Return a robot as MJCF; one of several carries a crate, which the scanners of others see."""
    x, y, heading = starts[number]
    mark = part("", number)
    crate = (
        f'<geom name="crate{mark}" type="box" size=".15 .13 .07" pos="-.06 0 .185" mass="1"'
        ' rgba=".62 .47 .3 1"/>'
    ) * (len(starts) > 1)
    wheels = "".join(
        f'<body name="{side} wheel{mark}" pos="0 {sign * TRACK / 2} 0"><joint name="{side}{mark}"'
        f' axis="0 1 0" damping=".02" armature="{ROTOR}"/>'
        f'<geom name="{side} tyre{mark}" type="cylinder" size="{RADIUS * worn} .02"'
        ' zaxis="0 1 0" mass="1" friction=".8 .005 .0001" condim="4" rgba=".1 .1 .1 1"/>'
        f'<geom type="box" size=".06 .021 .012" mass="0" contype="0" conaffinity="0"'
        ' rgba=".8 .8 .8 1"/></body>'
        for side, sign, worn in (("left", 1, WORN[0]), ("right", -1, WORN[1]))
    )
    casters = "".join(
        f'<geom type="sphere" pos="{cx} 0 -.059" size=".04" mass=".2" friction=".02 .001 .0001"'
        ' condim="3" priority="1" rgba=".3 .3 .3 1"/>'
        for cx in (-0.2, 0.2)
    )
    return f"""
<body name="robot{mark}" pos="{x} {y} {RADIUS}"
  quat="{math.cos(heading / 2)} 0 0 {math.sin(heading / 2)}">
  <freejoint name="base{mark}"/>
  <geom name="chassis{mark}" type="box" size=".25 .17 .05" pos="0 0 .03" mass="14"
    rgba=".1 .45 .7 1"/>
  <geom name="deck{mark}" type="box" size=".24 .16 .015" pos="0 0 .1" mass="2" rgba=".9 .9 .92 1"/>
  <geom name="mast{mark}" type="box" size=".025 .025 .13" pos="{CAMERA_X - 0.04} 0 .22" mass=".5"
    rgba=".25 .27 .3 1"/>
  <geom name="head{mark}" type="box" size=".03 .06 .03"
    pos="{CAMERA_X - 0.034} 0 {CAMERA_Z - RADIUS}"
    mass=".3" rgba=".15 .15 .15 1"/>
  {crate}{casters}{wheels}
  <camera name="front{mark}" pos="{CAMERA_X} 0 {CAMERA_Z - RADIUS}" xyaxes="0 -1 0 0 0 1"
    fovy="1.1226"/>
</body>"""

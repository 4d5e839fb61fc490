"""A simulated robot with a front and a rear camera, 0.4 m apart."""

import math

import numpy as np

from homeward.drives.drive import Drive, HomeBearing, Odometry, Sightings, Truth
from homeward.drives.settings import DriveSettings
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, Twist, advance, between, compose

CAMERAS = {"front": Pose(0.2, 0.0, 0.0), "rear": Pose(-0.2, 0.0, math.pi)}
SETTINGS = {
    "sensor": {"x": 0.2, "y": 0.0, "yaw": 0.0, "bearing_sigma": 0.01},
    "cameras": {"rear": {"x": -0.2, "y": 0.0, "yaw": math.pi}},
    "odometry": {"speed_sigma": 0.02, "turn_sigma": 0.02, "speed_scale_sigma": 0.0},
}
HALF_VIEW, SIGMA, DT = math.radians(65), 0.01, 0.05


def simulated(seed, seconds=40.0, settings=None, speed=0.3, rate=0.4):
    """A drive on an eight among 14 landmarks; the cameras take turns, each at 5 Hz."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, seconds, DT)
    v = np.full(t.size, speed)
    omega = rate * np.sign(np.sin(2 * np.pi * t / 31.4) + 1e-9)
    around = rng.uniform(-0.15, 0.15, 14) + np.arange(14) * math.tau / 14
    away = rng.uniform(2.0, 4.0, 14)
    places = np.stack([away * np.cos(around), 0.5 + away * np.sin(around)], axis=1)

    def seen(pose, name):
        eye = compose(pose, CAMERAS[name])
        for i, place in enumerate(places):
            to = between(eye, Pose(*place, 0.0))
            bearing = math.atan2(to.y, to.x)
            if abs(bearing) < HALF_VIEW:
                yield f"L{i}", float(wrap(bearing + rng.normal(0.0, SIGMA)))

    home = {n: HomeBearing(b, SIGMA, c) for c in CAMERAS for n, b in seen(Pose(0, 0, 0), c)}
    pose, poses, rows = Pose(0.0, 0.0, 0.0), [], []
    for k in range(t.size):
        poses.append(pose)
        if k % 2 == 0:
            camera = ("front", "rear")[k // 2 % 2]
            rows += [(t[k], *each, SIGMA, camera) for each in seen(pose, camera)]
        pose = advance(pose, Twist(v[k], omega[k]), DT)
    noise = rng.normal(0.0, 0.02 / math.sqrt(DT), (2, t.size)) * (rate > 0.0)
    noisy = (v + noise[0] * (speed > 0.0), omega + noise[1])
    stamps, landmark, bearing, sigma, camera = zip(*rows, strict=True)
    seen_by = Sightings(
        np.array(stamps),
        np.array(landmark, object),
        np.array(bearing),
        np.array(sigma),
        camera=np.array(camera, object),
    )
    truth = Truth(t, *np.array(poses).T)
    given = DriveSettings(**(SETTINGS if settings is None else settings))
    return Drive("eight", Odometry(t, *noisy), seen_by, home, given, truth)

"""A robot that turns on the spot at home, and what its odometry and narrow camera say of it."""

import numpy as np

from homeward.drives.drive import Odometry, Sightings
from homeward.drives.settings import OdometryNoise, Sensor
from homeward.geometry.angles import wrap

RATE, REST_S, STEP_S = 0.5, 1.0, 0.05
TOLD = OdometryNoise(
    turn_sigma=0.005, turn_scale_sigma=0.02, turn_bias_sigma=0.002, speed_scale_sigma=0.01
)
"""Of an odometry that is told; its robot turns about its centre."""


def turned(
    seed,
    *,
    sensor=None,
    turn=1.05 * 2.0 * np.pi,
    landmarks=12,
    view=np.pi / 3.0,
    told=TOLD,
    scale=None,
    lag=0.0,
    slip=0.0,
):
    """Return odometry, sightings, and the true home bearings by name.

    Landmarks stand as the model has it a priori; `told` None: odometry errs as wheels do that
    nobody calibrated.
    """
    rng = np.random.default_rng(seed)
    sensor = sensor or Sensor(bearing_sigma=0.009)
    inverse = np.abs(rng.normal(0.5, 0.3, landmarks)).clip(0.05, 1.2)
    stand = np.exp(1j * rng.uniform(-np.pi, np.pi, landmarks)) / inverse
    camera = complex(sensor.x, sensor.y)

    def heading(t):
        return np.clip(t - REST_S, 0.0, turn / RATE) * RATE

    def eye(t):  # slip: the centre is driven on a circle
        way = slip * 1j * (1.0 - np.exp(1j * heading(t)))
        return way + np.exp(1j * heading(t)) * camera

    end = 2.0 * REST_S + turn / RATE
    t = np.arange(0.0, end + STEP_S, STEP_S)
    step = heading(t + STEP_S - lag) - heading(t - lag)
    drawn = rng.normal(size=2)
    if told is None:
        scale = 0.05 * drawn[0] if scale is None else scale
        noise, bias = 0.05 * np.sqrt(step), 0.0
    else:
        scale = told.turn_scale_sigma * drawn[0] if scale is None else scale
        noise, bias = told.turn_sigma * np.sqrt(STEP_S), told.turn_bias_sigma * drawn[1]
    measured = (1.0 + scale) * step + bias * STEP_S + noise * rng.normal(size=t.size)
    rows = []
    for now in np.arange(0.0, end, 0.2).tolist():
        seen = wrap(np.angle(stand - eye(now)) - heading(now) - sensor.yaw)
        noisy = wrap(seen + 0.009 * rng.normal(size=landmarks))
        inside = np.flatnonzero(np.abs(seen) < view / 2).tolist()
        rows += [(now, f"L{i:02d}", float(noisy[i]), np.nan) for i in inside]
    true = wrap(np.angle(stand - camera) - sensor.yaw)
    home = {f"L{i:02d}": float(b) for i, b in enumerate(true)}
    return Odometry(t, 0.0 * t, measured / STEP_S), Sightings.of_rows(rows), home

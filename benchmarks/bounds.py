"""The Cramer-Rao bounds against a Monte Carlo of an efficient estimator, and against closed forms.

`python -m benchmarks.bounds [--runs 400]`. The estimator is maximum likelihood over the whole
drive (poses, landmarks, odometry errors), by Gauss-Newton from ground truth. rho is
sqrt(mean(e' B^-1 e) / 3) over the runs, with its 95 % interval for an efficient estimator.
"""

import numpy as np

from benchmarks.monte_carlo import parsed
from homeward.geometry.angles import wrap
from homeward.lab.bounds import posterior_bound
from homeward.lab.planning.accuracy import Arcs
from homeward.lab.planning.settings import HomePlace, Plan

STEPS, DT, SPEED = 6, 0.8, 0.25
STEP = 1e-6


class Arc:
    """An arc among landmarks all round home, and its measurements."""

    def __init__(self, bearing: float, turn: float, seed: int = 3) -> None:
        rng = np.random.default_rng(seed)
        self.twists = np.tile([SPEED, turn], (STEPS, 1))
        angles = 2 * np.pi * np.arange(6) / 6 + rng.uniform(-0.3, 0.3, 6)
        far = rng.uniform(1.5, 3.0, 6)
        self.marks = np.stack([far * np.cos(angles), far * np.sin(angles)], axis=1)
        self.visible = rng.random((STEPS + 1, 6)) < 0.8
        self.sigmas = {
            "bearing_sigma": bearing,
            "home_sigma": bearing,
            "speed_sigma": 0.01,
            "turn_sigma": 0.01,
        }
        self.truth = np.concatenate([[0.7, -0.5, 0.3], np.zeros(2 * STEPS), self.marks.ravel()])
        self.scale = np.repeat(
            [0.01 / np.sqrt(DT), bearing], [2 * STEPS, int(self.visible.sum()) + 6]
        )

    def poses(self, unknowns: np.ndarray) -> np.ndarray:
        """Return all poses (..., steps + 1, 3) of unknowns (..., 3 + 2 steps + 2 q)."""
        poses = [unknowns[..., :3]]
        errors = unknowns[..., 3 : 3 + 2 * STEPS].reshape(*unknowns.shape[:-1], STEPS, 2)
        for k in range(STEPS):
            v, omega = np.moveaxis(self.twists[k] + errors[..., k, :], -1, 0)
            x, y, heading = np.moveaxis(poses[-1], -1, 0)
            chord = v * DT * np.sinc(omega * DT / 2 / np.pi)
            middle = heading + omega * DT / 2
            ahead = x + chord * np.cos(middle), y + chord * np.sin(middle)
            poses.append(np.stack([*ahead, heading + omega * DT], axis=-1))
        return np.stack(poses, axis=-2)

    def measured(self, unknowns: np.ndarray) -> np.ndarray:
        """Return odometry errors, bearings on the arc and at home, shape (..., m)."""
        poses, q = self.poses(unknowns), len(self.marks)
        marks = unknowns[..., 3 + 2 * STEPS :].reshape(*unknowns.shape[:-1], 1, q, 2)
        d = marks - poses[..., :, None, :2]
        seen = wrap(np.arctan2(d[..., 1], d[..., 0]) - poses[..., 2:3])[..., self.visible]
        home = np.arctan2(marks[..., 0, :, 1], marks[..., 0, :, 0])
        return np.concatenate([unknowns[..., 3 : 3 + 2 * STEPS], seen, home], axis=-1)

    def estimate(self, data: np.ndarray) -> np.ndarray:
        """Return the unknowns of greatest likelihood."""
        x = self.truth.copy()
        for _ in range(8):
            both = x + STEP * np.stack([np.eye(x.size), -np.eye(x.size)])
            ahead, back = self.measured(both)
            jacobian = wrap(ahead - back).T / (2 * STEP) / self.scale[:, None]
            residual = wrap(data - self.measured(x)) / self.scale
            x = x + np.linalg.lstsq(jacobian, residual, rcond=None)[0]
        return x

    def bound(self) -> np.ndarray:
        """Return the bound of the last pose, shape (3, 3)."""
        poses = self.poses(self.truth)
        dt = np.full(STEPS, DT)
        return posterior_bound(poses, self.twists, dt, self.marks, self.visible, **self.sigmas)[-1]


def monte_carlo(bearing_deg: float, turn: float, runs: int) -> str:
    """Return a line with rho and its interval."""
    arc = Arc(np.radians(bearing_deg), turn)
    rng = np.random.default_rng(1)
    bound = arc.bound()
    end = arc.poses(arc.truth)[-1]
    ratios = []
    for _ in range(runs):
        data = arc.measured(arc.truth) + arc.scale * rng.standard_normal(arc.scale.size)
        error = arc.poses(arc.estimate(data))[-1] - end
        error[2] = wrap(error[2])
        ratios.append(error @ np.linalg.solve(bound, error) / 3)
    half = 1.96 * np.sqrt(2 / 3 / runs) / 2
    sigma = np.sqrt(bound[0, 0] + bound[1, 1])
    return (
        f"bearings {bearing_deg} deg, turning {turn} rad/s: bound {sigma:.4f} m,"
        f" rho {np.sqrt(np.mean(ratios)):.3f} (95 %: {1 - half:.3f} to {1 + half:.3f}),"
        f" {runs} runs"
    )


def ring_closed_form() -> tuple[float, float, float, float]:
    """Return computed and exact errors of position and heading in a ring of surveyed landmarks."""
    q, r, sigma, stops = 12, 3.0, 0.01, 2
    angles = 2 * np.pi * np.arange(q) / q
    plan = Plan.model_validate(
        {
            "outline": [(-9, -9), (9, -9), (9, 9), (-9, 9)],
            "home": HomePlace(x=0.5, y=0.5),
            "sensor": {"bearing_sigma": sigma},
            "odometry": {"speed_sigma": 0, "turn_sigma": 0},
            "drive": {"length": 1e-6, "turn": 0, "stops": stops},
            "landmark_sigma": 1e-6,
        }
    )
    marks = r * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    arcs = Arcs(plan)
    seen, stored = np.ones((1, q), bool), np.zeros(q, bool)
    information = arcs.information(np.zeros((1, 2)), marks, seen, stored, 0)
    fix = arcs.fix(information.every)
    root = np.sqrt(q * stops)
    return float(fix.position[0]), 2 * r * sigma / root, float(fix.heading[0]), sigma / root


def dead_reckoning_closed_form(steps: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    """Return computed and exact variances ahead, aside and of the heading by dead reckoning."""
    T, v, sigma_v, sigma_w, start = 20.0, 0.3, 0.02, 0.03, 0.01
    t = np.linspace(0, T, steps + 1)
    poses = np.stack([v * t, 0 * t, 0 * t], axis=1)
    bound = posterior_bound(
        poses,
        np.tile([v, 0.0], (steps, 1)),
        np.diff(t),
        np.array([[1.0, 2.0]]),
        np.zeros((steps + 1, 1), bool),
        bearing_sigma=1.0,
        home_sigma=1.0,
        speed_sigma=sigma_v,
        turn_sigma=sigma_w,
        start_covariance=start * np.eye(3),
    )[-1]
    aside = start + start * (v * T) ** 2 + (sigma_w * v) ** 2 * T**3 / 3
    return np.diag(bound), np.array([start + sigma_v**2 * T, aside, start + sigma_w**2 * T])


def main() -> None:
    options = parsed(__doc__, runs=400)
    for bearing_deg in (0.2, 0.5, 1.0):
        for turn in (0.0, 0.3):
            print(monte_carlo(bearing_deg, turn, options.runs), flush=True)
    found, exact, turned, exactly = ring_closed_form()
    print(
        f"in a ring of surveyed landmarks: position {found:.6f} m (closed form {exact:.6f}),"
        f" heading {turned:.7f} rad ({exactly:.7f})"
    )
    found_variances, exact_variances = dead_reckoning_closed_form()
    ratio = ", ".join(f"{r:.6f}" for r in found_variances / exact_variances)
    print(f"straight dead reckoning, variances ahead, aside, of heading over closed form: {ratio}")


if __name__ == "__main__":
    main()

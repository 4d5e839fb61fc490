"""The problem on which homeward and its peers are timed."""

from dataclasses import dataclass

import numpy as np

from homeward.geometry.frames import Polar, Pose, bearing, from_polar

DT = 0.05
GUARD = 0.01
INPUT_VARIANCE = np.array([0.01**2, 0.02**2])
WALK = 1e-6  # added to the variance of every state at every sample
BEARING_VARIANCE = 0.02**2


@dataclass(frozen=True)
class Scene:
    """A recorded run: commands and bearings of q landmarks, all known from the start.

    Bearings are not wrapped, so that peers may use plain differences.
    """

    stored: np.ndarray  # (q,) [rad]
    state: np.ndarray  # (3 + q,), the first estimate
    covariance: np.ndarray  # (3 + q, 3 + q)
    control: np.ndarray  # (steps, 2)
    bearings: np.ndarray  # (steps, q) [rad]
    mask: np.ndarray  # (steps, q), 1 where seen; the same number of landmarks in every sample

    @property
    def steps(self) -> int:
        return len(self.control)

    @property
    def q(self) -> int:
        return self.stored.size


def make_scene(steps: int, q: int = 7, seen: int = 5, seed: int = 1) -> Scene:
    """Return a run on a weaving path away from home, with `seen` of q landmarks in view."""
    rng = np.random.default_rng(seed)
    angles = 2 * np.pi * np.arange(q) / q + rng.uniform(-0.3, 0.3, q) * 7 / q
    landmarks = rng.uniform(1, 2, q)[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    pose = np.array(from_polar(Polar(0.75, -0.872, 0.349)))
    look = [_look(pose, landmarks)]
    control = np.zeros((steps, 2))
    for k in range(steps):
        v, omega = control[k] = 0.125, 0.6 + 0.3 * np.sin(0.05 * k)
        middle = pose[2] + 0.5 * omega * DT
        pose = pose + DT * np.array([v * np.cos(middle), v * np.sin(middle), omega])
        look.append(_look(pose, landmarks))
    truth = np.unwrap(look, axis=0)
    mask = np.zeros((steps, q))
    mask[:, :seen] = 1.0
    first = np.concatenate([[0.75, -0.872, 0.349], truth[0]])
    return Scene(
        stored=np.arctan2(landmarks[:, 1], landmarks[:, 0]),
        state=first + np.r_[0.03, -0.03, 0.03, np.zeros(q)],
        covariance=np.diag(np.r_[0.05**2, 0.1**2, 0.1**2, np.full(q, BEARING_VARIANCE)]),
        control=control,
        bearings=truth[1:] + rng.normal(size=(steps, q)) * 0.02,
        mask=rng.permuted(mask, axis=1),
    )


def _look(pose: np.ndarray, landmarks: np.ndarray) -> np.ndarray:
    return np.array([bearing(Pose(*pose), *mark) for mark in landmarks])


def given(scene: Scene) -> dict[str, object]:
    """Return initial belief and constants of a filter."""
    return {
        "state": scene.state,
        "covariance": scene.covariance,
        "active": 1.0,
        "stored": scene.stored,
        "dt": DT,
        "input_covariance": np.diag(INPUT_VARIANCE),
        "state_variance": np.full(scene.state.size, WALK),
        "variance": BEARING_VARIANCE,
        "gate": np.inf,
        "minimum_visible": 1.0,
    }


def series(scene: Scene) -> dict[str, np.ndarray]:
    """Return the inputs of each sample."""
    return {"control": scene.control, "bearings": scene.bearings, "mask": scene.mask}

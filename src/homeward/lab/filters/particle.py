"""The particle filter: pose samples, each with its own map; for a poorly known start."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from homeward.geometry.angles import wrap
from homeward.geometry.frames import Polar, Pose, Twist, advance, from_polar
from homeward.lab.filters.backend import (
    LOST_SIGMA,
    Angles,
    CartesianFilter,
    LandmarkBelief,
    MaybeTwist,
    Outputs,
    Setup,
    empty_outputs,
)
from homeward.lab.model import home_anchored_bearing


@dataclass(frozen=True)
class Particles:
    """N weighted poses, each with a Gaussian for every landmark."""

    pose: np.ndarray
    """(3, N), x [m], y [m], heading [rad]."""
    weight: np.ndarray
    """(N,), normalised to a sum of one."""
    mark: np.ndarray
    """(2, N, q), home bearing [rad] and inverse distance from home [1/m]."""
    spread: np.ndarray
    """(2, 2, N, q), their covariance."""
    active: np.ndarray
    """(q,), 1 once a landmark has been seen, else 0."""
    draws: int
    """Number of random draws; the same belief always draws the same numbers."""


class ParticleFilter(CartesianFilter):
    """The Rao-Blackwellised particle filter, as a `homeward.lab.filters.backend.FilterBackend`.

    Given the path, landmarks are independent: each particle is a path with a two-state EKF for each
    landmark. A bearing is an outlier with the small probability `outliers`, so that one wrong
    landmark does not remove correct particles. A sighting outside the gate changes no landmark.

    References
    ----------
    Montemerlo, Thrun, Koller, Wegbreit, "FastSLAM", AAAI 2002; resampling: Kitagawa, "Monte Carlo
    Filter and Smoother for Non-Gaussian Nonlinear State Space Models", 1996 (systematic).
    """

    def __init__(
        self,
        setup: Setup,
        home_sigma: np.ndarray,
        inverse: tuple[float, float],
        particles: int,
        outliers: float,
        seed: int = 0,
    ) -> None:
        super().__init__(setup, home_sigma, inverse)
        self._outliers, self._number, self._seed = outliers, particles, seed

    def start(self) -> Particles:
        """Return particles drawn from the prior."""
        prior, size = self.setup, (self._number, self.stored.size)
        drawn = np.array(prior.polar)[:, None] + prior.sigmas[:, None] * self._normal(0, 3)
        mark = np.empty((2, *size))
        mark[0], mark[1] = self.stored, self.inverse[0]
        spread = np.zeros((2, 2, *size))
        spread[0, 0], spread[1, 1] = self.home_sigma**2, self.inverse[1] ** 2
        even = np.full(self._number, 1 / self._number)
        pose = np.array(from_polar(Polar(*drawn)))
        return Particles(pose, even, mark, spread, np.zeros(self.stored.size), 1)

    def predict(self, belief: Particles, interval: float, twist: MaybeTwist) -> Particles:
        """Return the belief `interval` [s] later: every particle draws its own noise."""
        if interval <= 0.0:
            return belief
        density = self.setup.input_density if twist else np.full(2, LOST_SIGMA**2)
        noise = np.sqrt(density / interval)[:, None] * self._normal(belief.draws, 2)
        v, omega = np.array(twist or (0.0, 0.0))[:, None] + noise
        pose = np.stack(advance(Pose(*belief.pose), Twist(v, omega), interval))
        return replace(belief, pose=pose, draws=belief.draws + 1)

    def update(self, belief: Particles, seen: Angles, sigmas: Angles) -> tuple[Particles, Outputs]:
        """Return the belief after one stamp, and the outputs averaged over the particles."""
        out = empty_outputs(self.stored.size)
        if len(seen) < max(self.minimum_visible, 1):
            return belief, out
        rows, measured, own = self.sighted(seen, sigmas)
        mark, spread = belief.mark[:, :, rows], belief.spread[:, :, :, rows]
        expected, slope = _sight(belief.pose, mark)
        innovation = wrap(measured - expected)
        across = np.einsum("ijnk,jnk->ink", spread, slope)
        variance = np.einsum("ink,ink->nk", across, slope) + own**2
        right = np.exp(-0.5 * innovation**2 / variance) / np.sqrt(2 * np.pi * variance)
        share = self._outliers / (2 * math.pi)
        likelihood = np.log((1 - self._outliers) * right + share).sum(axis=1)
        weight = belief.weight * np.exp(likelihood - likelihood.max())
        inside = innovation**2 <= self.setup.gate * variance
        gain = across * (inside / variance)
        new_mark, new_spread = belief.mark.copy(), belief.spread.copy()
        new_mark[:, :, rows] = mark + gain * innovation
        new_spread[:, :, :, rows] = spread - gain[:, None] * across[None]
        mean = belief.weight @ innovation
        out["innovation"][rows] = mean
        out["innovation_variance"][rows] = belief.weight @ (variance + (innovation - mean) ** 2)
        weight /= weight.sum()
        out["accepted"][rows] = weight @ inside > 0.5
        active = np.maximum(belief.active, out["accepted"])
        after = replace(belief, weight=weight, mark=new_mark, spread=new_spread, active=active)
        return self._resampled(after), out

    def pose(self, belief: Particles) -> tuple[Pose, np.ndarray]:
        """Return mean and covariance of the poses."""
        x, y, heading = belief.pose
        w = belief.weight
        mean = math.atan2(w @ np.sin(heading), w @ np.cos(heading))
        off = np.stack([x - w @ x, y - w @ y, wrap(heading - mean)])
        return Pose(float(w @ x), float(w @ y), mean), (off * w) @ off.T

    def landmarks(self, belief: Particles) -> LandmarkBelief:
        """Return mean and standard deviation over all particles."""
        w = belief.weight
        home, inverse = (w @ m for m in belief.mark)
        variance = w @ (belief.spread[1, 1] + (belief.mark[1] - inverse) ** 2)
        with np.errstate(divide="ignore"):
            return LandmarkBelief(wrap(home), 1 / inverse, np.sqrt(variance) / inverse**2)

    def _resampled(self, belief: Particles) -> Particles:
        """Resample where the effective number of particles is at most half of them."""
        number = self._number
        if 1 / np.sum(belief.weight**2) > number / 2:
            return belief
        at = (np.arange(number) + self._rng(belief.draws).random()) / number
        kept = np.minimum(np.searchsorted(np.cumsum(belief.weight), at), number - 1)
        return replace(
            belief,
            pose=belief.pose[:, kept],
            weight=np.full(number, 1 / number),
            mark=belief.mark[:, kept],
            spread=belief.spread[:, :, kept],
            draws=belief.draws + 1,
        )

    def _rng(self, draws: int) -> np.random.Generator:
        return np.random.default_rng([self._seed, draws])

    def _normal(self, draws: int, rows: int) -> np.ndarray:
        return self._rng(draws).standard_normal((rows, self._number))


def _sight(pose: np.ndarray, mark: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return bearings (N, k) of landmarks (2, N, k), and their derivatives (2, N, k)."""
    x, y, heading = (p[:, None] for p in pose)
    home, inverse = mark
    c, s = np.cos(home), np.sin(home)
    along, across = c - inverse * x, s - inverse * y
    slope = np.stack([along * c + across * s, across * x - along * y]) / (along**2 + across**2)
    return home_anchored_bearing(Pose(x, y, heading), home, inverse), slope

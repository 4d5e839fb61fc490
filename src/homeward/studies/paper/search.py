"""The best Pi and M of the PI-EKF, searched over layouts and judged on others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal

import numpy as np

from homeward.studies.blocks.finish import Work
from homeward.studies.paper.layouts import LayoutSettings, Outcome, Question, ask, changed
from homeward.studies.paper.world import CaseName

SCALES = tuple(float(g) for g in np.logspace(-5, -0.5, 19))
"""Products of Pi and M that are tried as printed: Pi a multiple of the identity, M of ones."""
DRAWN, REFINED, BEST = 40, 20, 4
"""Free gains drawn at random; drawn round the best of those, twice; how many count as best."""

Gains = tuple[float, float, float, float]
"""The diagonal of Pi: for R, theta, alpha, and every bearing."""
Integral = float | Literal["HT", "own"]
FAMILIES: dict[str, Integral] = {
    "Pi a number, M ones": 1.0,
    "Pi a number, M = H'": "HT",
    "free Pi, M ones": 1.0,
    "free Pi, M own": "own",
}
SEARCHED: tuple[CaseName, ...] = ("2", "4")


@dataclass(frozen=True)
class Tried:
    """One choice of Pi and M in one case."""

    family: str
    case: CaseName
    Pi: float | Gains
    M: Integral
    chosen_by: float
    """Its cost on the layouts that choose."""


@dataclass(frozen=True)
class Best:
    """The best of a family in one case, on layouts that had no part in the choice."""

    tried: Tried
    pi_ekf: np.ndarray
    """(layouts, 3), RMSE of R [m], theta, alpha [rad]."""
    ekf: np.ndarray
    """(layouts, 3), of the EKF in the same layouts."""

    @property
    def cost(self) -> float:
        """The cost where it was not chosen."""
        return cost(self.pi_ekf, self.ekf)


@dataclass(frozen=True)
class Search:
    """Everything that was tried, and the best of each family in each case."""

    tried: tuple[Tried, ...]
    best: tuple[Best, ...]


def cost(pi_ekf: np.ndarray, ekf: np.ndarray) -> float:
    """Return how much larger the PI-EKF's errors are than the EKF's; below 1: smaller.

    The geometric mean over R, theta and alpha of the median ratio over the layouts.
    """
    with np.errstate(invalid="ignore"):
        ratio = np.where(np.isfinite(pi_ekf), pi_ekf / ekf, np.inf)
    return float(np.exp(np.mean(np.log(np.median(ratio, axis=0)))))


def search(settings: LayoutSettings, work: Work) -> Search:
    """Search the best Pi and M from the start of `settings.paper`.

    With Pi times the identity one number is searched, otherwise gains of their own for each kind of
    state. The first `searched` layouts choose, the next as many judge.
    """
    rounds = _Rounds(settings, work)
    ekf = rounds.reference()
    one, another, *free = FAMILIES
    tried = rounds.costs(list(product((one, another), SCALES, SEARCHED)), ekf)
    rng = np.random.default_rng(0)
    drawn = [_draw(rng) for _ in range(DRAWN)]
    for family in free:
        found = rounds.costs(list(product((family,), drawn, SEARCHED)), ekf)
        for width in (0.5, 0.2):
            near = [(family, _near(rng, t.Pi, width), t.case) for t in _leaders(found)]
            found += rounds.costs(near, ekf)
        tried += found
    return Search(tuple(tried), tuple(rounds.judge(tried)))


class _Rounds:
    """Asks for many gains at once, and tells progress over all rounds."""

    NUMBER = 9

    def __init__(self, settings: LayoutSettings, work: Work) -> None:
        self._settings, self._work, self._done = settings, work, 0
        self._n = min(settings.searched, settings.layouts)

    def reference(self) -> dict[CaseName, np.ndarray]:
        """Return the EKF's errors on the layouts that choose."""
        n = self._n
        asked = {case: Question(self._settings.paper, case, ("EKF",), n) for case in SEARCHED}
        answers = self._ask(asked)
        return {case: answers[case].of("EKF") for case in SEARCHED}

    def costs(
        self,
        gains: Sequence[tuple[str, float | Gains, CaseName]],
        ekf: dict[CaseName, np.ndarray],
    ) -> list[Tried]:
        """Return the costs of gains of a family, each in its case."""
        answers = self._ask(
            {i: self._question(Pi, FAMILIES[f], c, self._n) for i, (f, Pi, c) in enumerate(gains)}
        )
        return [
            Tried(family, case, Pi, FAMILIES[family], cost(answers[i].of("PI-EKF"), ekf[case]))
            for i, (family, Pi, case) in enumerate(gains)
        ]

    def judge(self, tried: list[Tried]) -> list[Best]:
        """Return the best of each family in each case, over layouts that did not choose."""
        n = self._n
        best = [
            min(
                (t for t in tried if t.family == family and t.case == case),
                key=lambda t: t.chosen_by,
            )
            for family in FAMILIES
            for case in SEARCHED
        ]
        asked: dict[Any, Question] = {
            i: self._question(t.Pi, t.M, t.case, 2 * n) for i, t in enumerate(best)
        }
        asked |= {c: Question(self._settings.paper, c, ("EKF",), 2 * n) for c in SEARCHED}
        answers = self._ask(asked)
        return [
            Best(t, answers[i].of("PI-EKF")[n:], answers[t.case].of("EKF")[n:])
            for i, t in enumerate(best)
        ]

    def _question(self, Pi: float | Gains, M: Integral, case: CaseName, layouts: int) -> Question:
        paper = changed(self._settings.paper, {"printed": {"Pi": Pi, "M": M}})
        return Question(paper, case, ("PI-EKF",), layouts)

    def _ask(self, asked: Mapping[Any, Question]) -> dict[Any, Outcome]:
        part = self._work.part(self._done / self.NUMBER, (self._done + 1) / self.NUMBER)
        answers = ask(part, asked)
        self._done += 1
        return answers


def _draw(rng: np.random.Generator) -> Gains:
    """Draw gains of either sign over four decades."""
    size = 10.0 ** rng.uniform(-4.5, -0.5, 4) * rng.choice([-1, 1], 4)
    return float(size[0]), float(size[1]), float(size[2]), float(size[3])


def _leaders(tried: list[Tried]) -> list[Tried]:
    """Return the best few of each case, as often as they are to be varied."""
    leaders = []
    for case in SEARCHED:
        ordered = sorted((t for t in tried if t.case == case), key=lambda t: t.chosen_by)
        leaders += [t for t in ordered[:BEST] for _ in range(REFINED // BEST)]
    return leaders


def _near(rng: np.random.Generator, Pi: float | Gains, width: float) -> Gains:
    """Draw gains near others: each multiplied by a lognormal factor, now and then of other sign."""
    assert isinstance(Pi, tuple)
    factors = np.exp(rng.normal(0, width * np.log(10), 4)) * rng.choice([-1, 1], 4, p=[0.05, 0.95])
    size = np.array(Pi) * factors
    return float(size[0]), float(size[1]), float(size[2]), float(size[3])

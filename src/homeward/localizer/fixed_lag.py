"""Fixed-lag smoothing while the robot drives: estimates a few seconds late, by later bearings too.

The smoother's window already contains the last keyframes. A copy of it is solved; the marginal of
a keyframe gives the pose there, and odometry connects the keyframes, as for a whole drive.
"""

from __future__ import annotations

import copy
import math

import numpy as np

from homeward.drives.drive import Drive
from homeward.errors import Attempts
from homeward.estimator import Estimate
from homeward.io.blas_threads import single_threaded_blas
from homeward.localizer.localizer import Localizer
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.smoothing import SolvedDrive, replaced
from homeward.localizer.tunables import RETAINED_S
from homeward.reasons import Reason
from homeward.track import Track, run


class FixedLag:
    """Smoothed estimates of a running localiser, at most `lag` seconds late.

    Parameters
    ----------
    localizer : Localizer
        A new localiser. Its own estimates do not change.
    lag : float
        Maximum delay while estimates are added [s], greater than 0.

    Examples
    --------
    >>> from homeward import FixedLag, Localizer
    >>> localizer = Localizer({"a": 0.1, "b": 1.2, "c": -2.0})
    >>> late = FixedLag(localizer, 5.0)
    >>> late.add(localizer.bearings(0.0, {"a": 0.1}))  # nothing is 5 s old yet
    []
    """

    def __init__(self, localizer: Localizer, lag: float) -> None:
        self._localizer, self._lag = localizer, lag
        self._waiting: list[tuple[float, Estimate]] = []
        """Times on the localiser's clock [s], and causal estimates."""
        self._newest = -math.inf
        """Time of the newest estimate [s]."""
        localizer.retain_odometry(lag + RETAINED_S)

    def add(self, estimate: Estimate) -> list[Estimate]:
        """Add the newest estimate of the localiser; return the smoothed ones that are due.

        Each of them replaces an earlier estimate, with its stamp. Some are the causal ones: where
        the robot was lost, where no map of that time is left, and where a camera is frozen. An
        estimate older than the last one gets no smoothed one.
        """
        t = self._localizer.drive_time(estimate.t)
        if not self._newest < t < math.inf:
            return []
        self._newest = t
        self._waiting.append((t, estimate))
        if t - self._waiting[0][0] < self._lag:
            return []
        # Several at once: a solution of the window takes as long for one as for many.
        return self._answer(t - max(self._lag - self._localizer.settings.keyframe_interval, 0.0))

    @property
    def waiting(self) -> list[Estimate]:
        """The causal estimates that are not smoothed yet."""
        return [estimate for _, estimate in self._waiting]

    def finish(self) -> list[Estimate]:
        """Return the smoothed estimates that are not due yet, at the end of a drive."""
        return self._answer(math.inf)

    @single_threaded_blas()
    def _answer(self, until: float) -> list[Estimate]:
        """Return the smoothed estimates up to a time [s]."""
        due = [(t, estimate) for t, estimate in self._waiting if t <= until]
        smoothed = self._smoothed(np.array([t for t, _ in due]), [estimate for _, estimate in due])
        self._waiting = self._waiting[len(due) :]
        return smoothed

    def _smoothed(self, times: np.ndarray, rows: list[Estimate]) -> list[Estimate]:
        """Return the smoothed estimates instead of causal ones at times (n,) [s]."""
        localizer = self._localizer
        if localizer.is_convention_wrong or localizer.chart.home.hypotheses is None or not rows:
            return rows
        window = copy.copy(localizer.chart.map.smoother)
        try:
            window.solve()
            retained = self._newest - self._lag - RETAINED_S
            before = [t for t in window.stamps if retained <= t <= times[0]]
            since = min(times[0] - self._lag, before[-1] if before else math.inf)
            solved = SolvedDrive(localizer, window, lambda *_: localizer.twists, since)
            found = solved.with_slips().estimates(rows, times)
        except np.linalg.LinAlgError:
            found = None
        unexplained = Reason.FROZEN.words, Reason.CONTRADICTED.words
        return [
            row if row.reason in unexplained else smoothed
            for row, smoothed in zip(rows, found or rows, strict=True)
        ]


def smooth_with_lag(drive: Drive, lag: float, settings: LocalizerSettings | None = None) -> Track:
    """Return the track of a drive, each row smoothed with the data of the next `lag` seconds.

    The rows are those of the causal track; see `FixedLag.add`. Parameters are as in
    `homeward.smooth`.
    """
    settings = settings or LocalizerSettings()
    localizer = Localizer(drive.home, settings=settings, known=drive.known, **drive.settings.robot)
    late, rows, attempts = FixedLag(localizer, lag), list[Estimate](), Attempts()

    def add(estimate: Estimate) -> None:
        rows.extend(attempts.attempt(estimate.t, [], late.add, estimate))

    track = run(drive, localizer, on_estimate=add)
    rest = attempts.attempt(drive.span[1], late.waiting, late.finish)
    return replaced(track, localizer, rows + rest, attempts.failures)

"""A chart: one map in the odometry frame, home found in it, and what both say of the robot."""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from collections.abc import Mapping

import numpy as np

from homeward.drives.drive import DriveSettings, HomeBearing
from homeward.estimator import Counts, Estimate, Innovation, LandmarkEstimate, Status
from homeward.localizer.home.hypotheses import (
    PROBABLE,
    Hypotheses,
    Seed,
    propagate,
    search,
    seeds,
    seeds_for,
    try_seed,
    update,
)
from homeward.localizer.home.observation import HomeObservation
from homeward.localizer.home.problem import HomeProblem
from homeward.localizer.inputs.reorder import BearingFrame
from homeward.localizer.map.state import HEAD, Marginal
from homeward.localizer.mapper import Mapper
from homeward.localizer.motion.preintegration import Motion
from homeward.localizer.output.landmark_report import LandmarkReport
from homeward.localizer.output.status import IntegrityMonitor, why_home_is_not_found
from homeward.localizer.settings import LocalizerSettings

NO_BEARINGS_S = 2.0
"""Without an accepted bearing for so long, the robot is coasting [s]."""
SEARCH_EVERY = 40
"""Keyframes between two searches for home from scratch ..."""
SEARCH_PATIENCE = 10
"""... which waits so many for one at which the window is not solved."""


class Chart:
    """A map of its own, and home in it.

    Parameters
    ----------
    home : dict of str to HomeBearing
        What the camera saw at home.
    drive : DriveSettings
        Camera, odometry and start prior as far as known.
    settings : LocalizerSettings
        Everything else.
    counts : Counts
        Where to count sightings.
    """

    def __init__(
        self,
        home: Mapping[str, HomeBearing],
        drive: DriveSettings,
        settings: LocalizerSettings,
        counts: Counts,
    ) -> None:
        self.counts, self.mapper = counts, Mapper(drive, settings, counts)
        self.hypotheses: Hypotheses | None = None
        """Where home may be in the map; None where it is not found."""
        self._home = HomeObservation(home, drive, settings)
        self._integrity = IntegrityMonitor(settings, drive.odometry)
        self._seen_from_home: list[str] = []
        self._seeds: deque[Seed] = deque()
        self._searched = 0
        """Keyframe at which other places for home were last looked for."""
        self._last_accepted = -math.inf

    def begin(self, t: float) -> None:
        """Let the map begin at the robot, at `t` [s]."""
        self.mapper.begin(t)
        if self._home.has_start:
            self._find_home(t)

    def add_bearings(self, frame: BearingFrame, now: float) -> list[Innovation]:
        """Take all sightings of one stamp; return their innovations.

        Parameters
        ----------
        frame : BearingFrame
            Not before the last one.
        now : float
            The newest stamp of all [s].
        """
        innovations, new_keyframe = self.mapper.add_bearings(*frame)
        if any(i.accepted for i in innovations):
            self._last_accepted = frame.t
        if new_keyframe:
            self._find_home(now)
        return innovations

    @property
    def is_lost(self) -> bool:
        """Whether the robot does not know where in the map it is."""
        return self.mapper.monitor.is_lost

    @property
    def has_pose(self) -> bool:
        """Whether there is a pose to give."""
        return self.hypotheses is not None and not self.is_lost and self._integrity.fixed

    def estimate(
        self, t: float, innovations: tuple[Innovation, ...] = (), complaint: str | None = None
    ) -> Estimate:
        """Return the estimate at `t` [s].

        Parameters
        ----------
        t : float
            Not before the newest keyframe.
        innovations : tuple of Innovation
            To go with it.
        complaint : str, optional
            The reason to give where there is no pose.
        """
        if self.hypotheses is None:
            words = complaint or why_home_is_not_found(
                self.mapper, self._home.bearings, self._seen_from_home
            )
            return Estimate(t, Status.MAPPING, words, None, None, innovations)
        if self.is_lost:
            words = complaint or self.mapper.monitor.reason.words
            return Estimate(t, Status.MAPPING, words, None, None, innovations)
        motion, moved = self.mapper.motion(t), None
        if motion is not Motion.identity():
            calibration = self.mapper.marginal.covariance[3:HEAD, 3:HEAD]
            drift = motion.covariance + motion.jacobian @ calibration @ motion.jacobian.T
            moved = motion.delta, drift
        found = self._integrity.estimate(t, moved, self._coasts(t), innovations)
        if found.pose is None:
            return dataclasses.replace(found, reason=complaint or found.reason)
        return found

    def landmarks(self, judge: bool) -> list[LandmarkEstimate]:
        """Return everything known of each landmark, in order of name; without home, unless told."""
        best = self.hypotheses.best if judge and self.hypotheses is not None else None
        found = best is not None and self._integrity.home_is_found(best)
        inventory = LandmarkReport(
            self._home.given_noise(self.mapper.noise),
            self._home.yaw(self.mapper),
            self.mapper.landmarks,
            self.mapper.marginal,
            self._seen_from_home,
            self.hypotheses if found else None,
        )
        return inventory.landmarks()

    @property
    def stayed(self) -> np.ndarray:
        """(q,), bool: which of the landmarks of `problem` did not move on the way."""
        former = self.mapper.landmarks.former
        return np.array([name not in former for name in self._seen_from_home], bool)

    def problem(self, marginal: Marginal) -> HomeProblem:
        """Return what is known of home's landmarks by a Gaussian of this map."""
        return self._home.problem(self._seen_from_home, self.mapper, marginal)

    def home_bearing_sigmas(self) -> dict[str, float]:
        """Return how well each home bearing is predicted by everything else [rad], by landmark."""
        if self.hypotheses is None:
            return {}
        variances = self.hypotheses.best.innovations[1]
        return dict(zip(self._seen_from_home, np.sqrt(variances).tolist(), strict=True))

    def conclude(self, marginal: Marginal) -> Hypotheses | None:
        """Find home anew by what a whole drive says; see `Localizer.conclude`."""
        before = self.hypotheses.fits if self.hypotheses is not None else ()
        found = search(self.problem(marginal), [(f.home, f.inliers) for f in before])
        if found is not None:
            self.mapper.marginal, self.hypotheses = marginal, found
            self._take(found, firm=True)
        return found

    def _find_home(self, t: float) -> None:
        """Follow home as the map changes; search for it anew when there is reason to."""
        if self.mapper.map_was_reset:
            self._home.forget_start()
        names = self.mapper.landmarks.seen_from(self._home.bearings)
        problem = self._home.problem(names, self.mapper, self.mapper.marginal)
        now = self.hypotheses
        if now is None or names != self._seen_from_home:
            also = seeds_for(now, self._seen_from_home, names) if now else []
            now = search(problem, also)
            self._seeds.clear()
            self._seen_from_home = names
        else:
            before = now.max_log_evidence
            now = (update if self.mapper.solved else propagate)(problem, now)
            if now is not None and now.max_log_evidence < before + math.log(PROBABLE):
                # The best set's home went astray: there may be a way back to it, or a better one.
                now = search(problem, [(f.home, f.inliers) for f in (*now.fits, *now.unconverged)])
            elif now is not None:
                now = self._try_next_seed(problem, now)
        self.hypotheses = now
        self._integrity.mount_covariance = self._home.mount_covariance(self.mapper.marginal)
        self._take(now, self.mapper.solved and not self._coasts(t))

    def _take(self, now: Hypotheses | None, firm: bool) -> None:
        """Let the standing be by these hypotheses."""
        self._integrity.update(now, firm, self.stayed)

    def _coasts(self, t: float) -> bool:
        """Return whether no bearing was accepted lately before `t` [s]."""
        return t - self._last_accepted > NO_BEARINGS_S

    def _try_next_seed(self, problem: HomeProblem, now: Hypotheses) -> Hypotheses:
        """Look now and then where else home might be, one place after the other."""
        since = self.mapper.window.newest - self._searched
        wait = SEARCH_PATIENCE if self.mapper.solved else 0
        if self._seeds and since >= wait:
            return try_seed(problem, now, self._seeds.popleft())
        if not self._seeds and since >= SEARCH_EVERY + wait:
            self._seeds.extend(seeds(problem))
            self._searched = self.mapper.window.newest
        return now

"""The robust localiser: a map in the odometry frame, and home found in it (see the package)."""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from collections.abc import Mapping

import numpy as np

from homeward.drives.clock import LATE_S, Clock
from homeward.drives.drive import DriveSettings, HomeBearing
from homeward.estimator import (
    FASTEST,
    Counts,
    Estimate,
    Innovation,
    LandmarkEstimate,
    Status,
)
from homeward.frames import Pose
from homeward.localizer.arrivals import Arrivals, Glance
from homeward.localizer.compiled import why_not
from homeward.localizer.elsewhere import Elsewhere
from homeward.localizer.inventory import Inventory
from homeward.localizer.mapper import Mapper
from homeward.localizer.marginal import HEAD, Marginal
from homeward.localizer.moved import (
    PROBABLE,
    Hypotheses,
    Start,
    carry,
    challenged,
    follow,
    renamed,
    search,
    starts,
)
from homeward.localizer.noise import deviation
from homeward.localizer.odometry import lag_words
from homeward.localizer.preintegration import Motion
from homeward.localizer.problem import HomeProblem
from homeward.localizer.reasons import LOST, REPLACED, why_home_is_not_found
from homeward.localizer.senses import REVERSED, Senses
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.standing import Standing
from homeward.localizer.stored import StoredHome

SCALE_NOTE = "The speed is taken at its word: bearings cannot tell an error of its scale."
NOISY_NOTE = "The bearings are noisier than was given: their deviations were taken for larger."
NO_BEARINGS_S = 2.0
"""Without an accepted bearing for so long, the robot is coasting [s]."""
SEARCH_EVERY = 40
"""Keyframes between two searches for home from scratch ..."""
SEARCH_PATIENCE = 10
"""... which waits so many for one at which the window is not solved."""


class Localizer:
    """The robust localiser, an `Estimator`.

    Parameters
    ----------
    home : dict of str to HomeBearing
        What the camera saw at home.
    drive : DriveSettings
        Camera, odometry and start prior as far as known.
    settings : LocalizerSettings
        Everything else.
    """

    name = "robust"

    def __init__(
        self,
        home: Mapping[str, HomeBearing],
        drive: DriveSettings | None = None,
        settings: LocalizerSettings | None = None,
    ) -> None:
        self.counts = Counts()
        self._notes = tuple(filter(None, (SCALE_NOTE, why_not())))
        self.settings = settings or LocalizerSettings()
        self._drive = drive or DriveSettings()
        self._home = StoredHome(home, self._drive, self.settings)
        self._mapper = Mapper(self._drive, self.settings, self.counts)
        self._standing = Standing(self.settings, self._drive.odometry)
        self._hypotheses: Hypotheses | None = None
        self._seen_from_home: list[str] = []
        self._starts: deque[Start] = deque()
        self._searched = 0
        """Keyframe at which other places for home were last looked for."""
        self._clock, self._arrivals, self._elsewhere = Clock(), Arrivals(), Elsewhere()
        self._senses = Senses(self._drive.sensor.yaw)
        self._t = -math.inf
        self._last_accepted = -math.inf

    @property
    def notes(self) -> tuple[str, ...]:
        """Assumptions, and what was found out about the robot; each a sentence."""
        if self._senses.reversed:
            return (*self._notes, f"{REVERSED[0].upper()}{REVERSED[1:]}.")
        noisy = (NOISY_NOTE,) if self._mapper.noise.doubt > 1.0 else ()
        mounting, calibration = self._mapper.mounting, self._mapper.window.calibration
        return (*self._notes, *noisy, *mounting.words(calibration), *lag_words(calibration))

    def odometry(self, t: float, v: float, omega: float) -> None:
        """Take a twist that holds from `t` [s] on: `v` [m/s] forward, `omega` [rad/s]."""
        t = self._clock.read(t)
        if not (math.isfinite(t) and abs(v) < FASTEST and abs(omega) < FASTEST):
            self.counts.reject("odometry is not finite, or no robot's")
            return
        late = self._is_too_late(t)
        self._arrivals.odometry(t, late)
        if late:
            self.counts.reject("odometry came late")
            return
        self._advance(t)
        self._mapper.twist(t, v, omega)
        self._senses.odometry(t, v, omega)
        self._see_what_is_due()

    def bearings(
        self, t: float, sightings: Mapping[str, float], sigmas: Mapping[str, float] | None = None
    ) -> Estimate:
        """Take all sightings of stamp `t` [s] (id to bearing [rad] from the camera's axis).

        Where odometry comes late they wait for it, and the answer is without them as yet.
        """
        said, t = t, self._clock.read(t)
        if not math.isfinite(t) or t < self._arrivals.newest or self._is_too_late(t):
            self._arrivals.late_bearings()
            self.counts.reject("bearings came late", len(sightings))
            return self.estimate(said)
        usable = {n: math.remainder(b, math.tau) for n, b in sightings.items() if math.isfinite(b)}
        self.counts.reject("bearing is not finite", len(sightings) - len(usable))
        self._advance(t)
        told = {n: deviation(s) for n, s in (sigmas or {}).items()}
        good = {n: s for n, s in told.items() if math.isfinite(s)}
        self._arrivals.bearings(Glance(t, usable, good))
        self._senses.bearings(t, usable)
        innovations = self._see_what_is_due()
        return dataclasses.replace(self._estimate(t, innovations), t=said)

    def estimate(self, t: float) -> Estimate:
        """Predict to `t` [s], not before the last sample, and change nothing."""
        if self._t == -math.inf:
            return Estimate(t, Status.WAITING, "no samples yet")
        at = self._clock.peek(t)
        now = max(at, self._t) if math.isfinite(at) else self._t
        return dataclasses.replace(self._estimate(now, ()), t=t)

    def landmarks(self) -> list[LandmarkEstimate]:
        """Return everything known of each landmark, in order of name."""
        best = None if self._hypotheses is None or self._senses.reversed else self._hypotheses.best
        found = best is not None and self._standing.home_is_found(best)
        inventory = Inventory(
            self._home.believed(self._mapper.noise),
            self._home.yaw(self._mapper),
            self._mapper.landmarks,
            self._mapper.marginal,
            self._seen_from_home,
            self._hypotheses if found else None,
        )
        return inventory.landmarks()

    @property
    def mount(self) -> Pose | None:
        """The camera on the robot, if it was found to sit elsewhere than was expected."""
        return self._mapper.mounting.found(self._mapper.window.calibration)

    @property
    def mapper(self) -> Mapper:
        """The map that home is found in."""
        return self._mapper

    def problem(self, marginal: Marginal) -> HomeProblem:
        """Return what is known of home's landmarks by a Gaussian of this map."""
        return self._home.problem(self._seen_from_home, self._mapper, marginal)

    def home_bearing_sigmas(self) -> dict[str, float]:
        """Return how well each home bearing is predicted by everything else [rad], by landmark."""
        if self._hypotheses is None:
            return {}
        variances = self._hypotheses.best.innovations[1]
        return dict(zip(self._seen_from_home, np.sqrt(variances).tolist(), strict=True))

    def conclude(self, marginal: Marginal) -> Hypotheses | None:
        """Find home anew by what a whole drive says at its end, for `landmarks` too.

        Parameters
        ----------
        marginal : Marginal
            What the whole drive says of the newest pose, the calibration and the landmarks.

        Returns
        -------
        Hypotheses or None
            None when home is not found: then everything stays as it was.
        """
        before = self._hypotheses.fits if self._hypotheses is not None else ()
        found = search(self.problem(marginal), [(f.home, f.right) for f in before])
        if found is not None:
            self._mapper.marginal, self._hypotheses = marginal, found
            self._standing.take(found, firm=True)
        return found

    def _is_too_late(self, t: float) -> bool:
        """Return whether a sample of `t` [s] can not be taken any more."""
        return t < self._t - LATE_S or not self._mapper.reaches(t)

    def _see_what_is_due(self) -> tuple[Innovation, ...]:
        """Take the bearings that need not wait; return the innovations of the newest of all."""
        innovations: list[Innovation] = []
        for glance in self._arrivals.due(self._mapper.felt, self._t):
            innovations, fresh = self._mapper.sight(*glance)
            self._elsewhere.look(glance.t, glance.sightings, innovations, self._mapper)
            if any(i.accepted for i in innovations):
                self._last_accepted = glance.t
            if fresh:
                self._find_home()
        return () if self._arrivals.waits else tuple(innovations)

    def _advance(self, t: float) -> None:
        """Let time come to `t` [s], unless it was there."""
        if self._t == -math.inf:
            self._mapper.begin(t)
            if self._home.has_start:
                self._find_home()
        self._t = max(self._t, t)

    def _find_home(self) -> None:
        """Follow home as the map changes; search for it anew when there is reason to."""
        if self._mapper.begun_anew:
            self._home.forget_start()
        names = self._mapper.landmarks.seen_from(self._home.bearings)
        problem = self._home.problem(names, self._mapper, self._mapper.marginal)
        now = self._hypotheses
        if now is None or names != self._seen_from_home:
            also = renamed(now, self._seen_from_home, names) if now else []
            now = search(problem, also)
            self._starts.clear()
            self._seen_from_home = names
        else:
            before = now.peak
            now = (follow if self._mapper.solved else carry)(problem, now)
            if now is not None and now.peak < before + math.log(PROBABLE):
                # The best set's home went astray: there may be a way back to it, or a better one.
                now = search(problem, [(f.home, f.right) for f in (*now.fits, *now.adrift)])
            elif now is not None:
                now = self._challenged(problem, now)
        self._hypotheses = now
        self._standing.mount_spread = self._home.mount_spread(self._mapper.marginal)
        self._standing.take(now, self._mapper.solved and not self._coasts(self._t))

    def _coasts(self, t: float) -> bool:
        """Return whether no bearing was accepted lately before `t` [s]."""
        return t - self._last_accepted > NO_BEARINGS_S

    def _challenged(self, problem: HomeProblem, now: Hypotheses) -> Hypotheses:
        """Look now and then where else home might be, one place after the other."""
        since = self._mapper.window.newest - self._searched
        wait = SEARCH_PATIENCE if self._mapper.solved else 0
        if self._starts and since >= wait:
            return challenged(problem, now, self._starts.popleft())
        if not self._starts and since >= SEARCH_EVERY + wait:
            self._starts.extend(starts(problem))
            self._searched = self._mapper.window.newest
        return now

    def _estimate(self, t: float, innovations: tuple[Innovation, ...]) -> Estimate:
        """Return the estimate at `t` [s]."""
        if self._senses.reversed:
            return Estimate(t, Status.MAPPING, REVERSED, None, None, innovations)
        complaint = self._arrivals.complaint()
        if self._hypotheses is None:
            words = complaint or why_home_is_not_found(
                self._mapper, self._home.bearings, self._seen_from_home
            )
            return Estimate(t, Status.MAPPING, words, None, None, innovations)
        if self._mapper.lost.since is not None:
            return Estimate(t, Status.MAPPING, complaint or LOST, None, None, innovations)
        motion, moved = self._mapper.motion(t), None
        if motion is not Motion.none():
            calibration = self._mapper.marginal.covariance[3:HEAD, 3:HEAD]
            drift = motion.covariance + motion.jacobian @ calibration @ motion.jacobian.T
            moved = motion.delta, drift
        found = self._standing.estimate(t, moved, self._coasts(t), innovations)
        if found.pose is None:
            return dataclasses.replace(found, reason=complaint or found.reason)
        if self._elsewhere.doubted:
            return dataclasses.replace(found, status=Status.UNVERIFIED, reason=REPLACED)
        return found

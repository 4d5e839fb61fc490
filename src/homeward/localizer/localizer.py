"""The robust localiser: a map in the odometry frame, and home found in it.

Where the robot is lost in its map, another one is begun beside it, and what gives a pose first
answers: the old map, in which the robot is looked for, or the new one, in which home is.
"""

from __future__ import annotations

import copy
import dataclasses
import math
import threading
from collections.abc import Mapping
from typing import Any, NamedTuple, Unpack

import numpy as np

from homeward.drives.clock import LATE_S, Clock
from homeward.drives.drive import DriveSettings, KnownLandmarks, Robot
from homeward.drives.known import (
    Home,
    known_home,
    known_landmarks,
    known_robot,
    known_settings,
)
from homeward.estimator import (
    FASTEST,
    Counts,
    Estimate,
    Innovation,
    LandmarkEstimate,
    Status,
    guarded,
)
from homeward.frames import Pose
from homeward.localizer.chart import Chart
from homeward.localizer.inputs.bearing_noise import valid_sigma
from homeward.localizer.inputs.reorder import BearingFrame, ReorderBuffer
from homeward.localizer.inputs.sign_check import SignCheck
from homeward.localizer.map.smoother import Smoother
from homeward.localizer.motion.odometry import lag_notes
from homeward.localizer.motion.twists import Twists
from homeward.localizer.settings import LocalizerSettings
from homeward.one_thread import one_thread
from homeward.reasons import Reason, Rejection

SCALE_NOTE = "The speed is taken at its word: bearings cannot tell an error of its scale."
NOISY_NOTE = "The bearings are noisier than was given: their deviations were taken for larger."
CLEARLY = 20
"""A map is better to which so many more sightings fit: where both are right, as many fit both."""


class OwnMap(NamedTuple):
    """Landmarks in the frame of the place where a robot began."""

    names: tuple[str, ...]
    """Of n landmarks."""
    positions: np.ndarray
    """(n, 2) [m]"""
    covariance: np.ndarray
    """(2 n, 2 n): of their coordinates in order [m^2]."""


class Localizer:
    """The robust localiser, an `Estimator`.

    Parameters
    ----------
    home : dict of str to float or HomeBearing
        What the camera saw at home: bearings [rad] by landmark, with a deviation where it is known.
    settings : LocalizerSettings or dict, optional
        Everything else.
    known : KnownLandmarks or dict, optional
        What is known of landmarks beforehand: a survey, distances of pairs.
    **robot : Robot
        What is known of the robot: `sensor`, `home_sensor`, `odometry`, `start`.

    Raises
    ------
    InputError
        When something of it cannot be used.
    """

    name = "robust"

    def __init__(
        self,
        home: Home,
        *,
        settings: LocalizerSettings | dict[str, Any] | None = None,
        known: KnownLandmarks | dict[str, Any] | None = None,
        **robot: Unpack[Robot],
    ) -> None:
        self.counts, self._turn = Counts(), threading.RLock()
        self._notes = (SCALE_NOTE,)
        self.settings = known_settings(LocalizerSettings, settings)
        self._home, self._robot = known_home(home), known_robot(robot)
        self._twists, self._known = Twists(), known_landmarks(known)
        self._chart = self._new_chart(self._robot, self.counts)
        self._beside: Chart | None = None
        """Another one, begun where the robot was lost in the first."""
        self._lead = 0
        """So many more sightings fit the other one, since then or since it was the worse one."""
        self._keeps = False
        self._clock, self._reorder = Clock(), ReorderBuffer()
        self._sign_check = SignCheck(self._robot.sensor.yaw)
        self._t = -math.inf

    @property
    def notes(self) -> tuple[str, ...]:
        """Assumptions, and what was found out about the robot; each a sentence."""
        if self.signs_reversed:
            words = Reason.SIGNS_REVERSED.words
            return (*self._notes, f"{words[0].upper()}{words[1:]}.")
        noise = self.chart.noise
        noisy: tuple[str, ...] = (NOISY_NOTE,) if noise.scale > 1.0 else ()
        noisy += noise.correlated.notes(noise.sigma) + self.chart.process_noise.notes
        extrinsics, calibration = self.chart.extrinsics, self.chart.map.state.calibration
        survey = self.chart.map.registration.survey
        scale = survey.notes(self.chart.map.state) if survey.known.tells else self._notes
        return (*scale, *noisy, *extrinsics.notes(calibration), *lag_notes(calibration))

    @guarded
    def odometry(self, t: float, v: float, omega: float) -> None:
        """Take a twist that holds from `t` [s] on: `v` [m/s] forward, `omega` [rad/s]."""
        t = self._clock.read(t)
        if not (math.isfinite(t) and abs(v) < FASTEST and abs(omega) < FASTEST):
            self._reject(Rejection.BAD_ODOMETRY)
            return
        late = self._is_too_late(t)
        self._reorder.odometry(t, late)
        if late:
            self._reject(Rejection.LATE_ODOMETRY)
            return
        self._advance(t)
        if not self._twists and self._robot.start is None:
            self._chart.begin(t)  # what may have been driven before is of no interest
        self._twists.add(t, v, omega)
        for chart in self.charts:
            chart.follow(t)
        self._twists.forget(min(chart.odometry.needed_since for chart in self.charts))
        self._process_due()

    @guarded
    def bearings(
        self, t: float, sightings: Mapping[str, float], sigmas: Mapping[str, float] | None = None
    ) -> Estimate:
        """Take all sightings of stamp `t` [s] (id to bearing [rad] from the camera's axis).

        Where odometry comes late they wait for it, and the answer is without them as yet. A look
        that saw nothing says nothing: the answer is that of `estimate`.
        """
        said, t = t, self._clock.read(t)
        if not math.isfinite(t) or t < self._reorder.newest or self._is_too_late(t):
            self._reorder.late_bearings()
            late = Rejection.LATE_BEARINGS if math.isfinite(t) else Rejection.BAD_BEARING
            self._reject(late, len(sightings))
            return self.estimate(said)
        usable = {n: math.remainder(b, math.tau) for n, b in sightings.items() if math.isfinite(b)}
        self._reject(Rejection.BAD_BEARING, len(sightings) - len(usable))
        if not usable:
            return self.estimate(said)
        self._advance(t)
        told = {n: valid_sigma(s) for n, s in (sigmas or {}).items()}
        good = {n: s for n, s in told.items() if math.isfinite(s)}
        self._reorder.bearings(BearingFrame(t, usable, good))
        if (twist := self._twists.before(t)) is not None:
            self._sign_check.bearings(t, usable, self._twists.heading(t), twist.v)
        innovations = self._process_due()
        return self._estimate(t, innovations, said)

    @guarded
    def estimate(self, t: float) -> Estimate:
        """Predict to `t` [s], not before the last sample, and change nothing."""
        if self._t == -math.inf:
            return Estimate(t, Status.WAITING, Reason.NO_SAMPLES.words)
        at = self._clock.peek(t)
        now = max(at, self._t) if math.isfinite(at) else self._t
        return self._estimate(now, (), t)

    @guarded
    @one_thread()
    def landmarks(self) -> list[LandmarkEstimate]:
        """Return everything known of each landmark, in order of name."""
        return self.chart.landmarks(judge=not self.signs_reversed)

    @property
    def signs_reversed(self) -> bool:
        """Whether bearings go against the turns of the odometry; then nothing is to be believed."""
        return self._sign_check.reversed

    @property
    def mount(self) -> Pose | None:
        """The camera on the robot, if it was found to sit elsewhere than was expected."""
        return self.chart.extrinsics.estimate(self.chart.map.state.calibration)

    @property
    def chart(self) -> Chart:
        """What answers: the newer map where it alone has a pose."""
        if self._beside is not None and self._beside.has_pose and not self._chart.has_pose:
            return self._beside
        return self._chart

    @property
    def charts(self) -> tuple[Chart, ...]:
        """All there are, the older one first."""
        return (self._chart,) if self._beside is None else (self._chart, self._beside)

    def keep_closed(self) -> None:
        """Keep everything that is said, for `conclude`; memory then grows with the drive."""
        self._keeps = True
        self._chart.keep_closed()

    @property
    def spells_lost(self) -> list[tuple[float, float]]:
        """From when until when the map that home is found in knows nothing of the robot [s]."""
        return [(-math.inf, self.chart.map.begun), *self.chart.monitor.spells_lost]

    @property
    def found_home(self) -> np.ndarray | None:
        """(3,): home's pose in the frame of `own_map`; None where it is not found by itself."""
        found = self.chart.home.hypotheses
        if found is None or not self.chart.has_pose or self.chart.map.registration.knows_home:
            return None
        return found.best.home

    def own_map(self) -> OwnMap:
        """Return the landmarks where they stand now, by what this robot saw and drove alone.

        Raises
        ------
        numpy.linalg.LinAlgError
            When that is too little.
        """
        chart = self.chart
        state, mapped = chart.map.registration.without_survey(), chart.map.landmarks.mapped
        index = chart.map.landmarks.index(mapped.values())
        at = state.columns(index).ravel()
        mean, covariance = state.positions[index], state.covariance[np.ix_(at, at)]
        if not self._known.tells:  # then the map takes the speed at its word
            given = self._robot.odometry.speed_scale_sigma
            sigma = self.settings.odometry.speed_scale if given is None else given
            covariance = covariance + sigma**2 * np.outer(mean, mean)
        return OwnMap(tuple(mapped), mean, covariance)

    def home_bearing_sigmas(self) -> dict[str, float]:
        """Return how well each home bearing is predicted by everything else [rad], by landmark."""
        return self.chart.home.bearing_sigmas()

    def conclude(self, whole: Smoother) -> bool:
        """Find home anew by what a whole drive says at its end, for `landmarks` too.

        Parameters
        ----------
        whole : Smoother
            The map with all keyframes open, solved.

        Returns
        -------
        bool
            Whether home is found; where it is not, everything stays as it was.
        """
        return self.chart.conclude(whole)

    def _reject(self, why: Rejection, number: int = 1) -> None:
        """Count samples that reach no map."""
        for chart in self.charts:
            chart.counts.reject(why, number)

    def _is_too_late(self, t: float) -> bool:
        """Return whether a sample of `t` [s] can not be taken any more."""
        return t < self._t - LATE_S or not all(c.odometry.accepts(t) for c in self.charts)

    def _process_due(self) -> tuple[Innovation, ...]:
        """Take the bearings that need not wait; return the innovations of the newest of all."""
        innovations: list[Innovation] = []
        for frame in self._reorder.due(self._twists.newest, self._t):
            with one_thread():
                innovations = self._process(frame)
        return () if self._reorder.waits else tuple(innovations)

    def _process(self, frame: BearingFrame) -> list[Innovation]:
        """Take a stamp into each map; return its innovations in the one that answers."""
        innovations = self._chart.add_bearings(frame, self._t)
        if self._beside is not None:
            return self._update_beside(self._beside, frame, innovations)
        if self._chart.monitor.fits_badly:
            self._begin_beside(frame.t)
        return innovations

    def _update_beside(
        self, beside: Chart, frame: BearingFrame, before: list[Innovation]
    ) -> list[Innovation]:
        """Take a stamp into the other map too, and leave one of them when the other is proven.

        Parameters
        ----------
        beside : Chart
            The other map.
        frame : BearingFrame
            The stamp.
        before : list of Innovation
            Of it, in the first map.

        Returns
        -------
        list of Innovation
            In the map that answers.
        """
        innovations = beside.add_bearings(frame, self._t)
        gained = sum(i.accepted for i in innovations) - sum(i.accepted for i in before)
        self._lead = max(0, self._lead + gained)
        if self._lead >= CLEARLY and self._is_sure(beside):
            self._chart, self.counts, self._beside = beside, beside.counts, None
        elif self._chart.monitor.fits_well and self._is_sure(self._chart):
            self._beside = None
        elif beside.monitor.is_lost:
            self._begin_beside(frame.t)
        return innovations if self.chart is beside else before

    def _is_sure(self, chart: Chart) -> bool:
        """Return whether a chart has a pose to rely on."""
        return chart.estimate(self._t).status is Status.LOCALISED

    def _begin_beside(self, t: float) -> None:
        """Begin another map at the robot, at `t` [s]."""
        anywhere = self._robot.model_copy(update={"start": None})
        self._beside = self._new_chart(anywhere, copy.deepcopy(self.counts))
        self._lead = 0
        if self._keeps:
            self._beside.keep_closed()
        self._beside.begin(t)

    def _new_chart(self, robot: DriveSettings, counts: Counts) -> Chart:
        """Return a chart of its own."""
        return Chart(self._home, robot, self.settings, counts, self._twists, self._known)

    def _advance(self, t: float) -> None:
        """Let time come to `t` [s], unless it was there."""
        if self._t == -math.inf:
            self._chart.begin(t)
        self._t = max(self._t, t)

    def _estimate(self, t: float, innovations: tuple[Innovation, ...], said: float) -> Estimate:
        """Return the estimate at `t` [s], which the drive's own clock `said` otherwise."""
        if self.signs_reversed:
            why = Reason.SIGNS_REVERSED.words
            return Estimate(said, Status.MAPPING, why, None, None, innovations)
        found = self.chart.estimate(t, innovations, self._reorder.complaint())
        return found if t == said else dataclasses.replace(found, t=said)

"""The robust localiser: a map in the odometry frame, and home found in it.

When the robot is lost, a second map is begun (as in a multi-map SLAM), and the first of both that
gives a pose answers: the old one by relocalisation, or the new one by finding home.
"""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from homeward.drives.drive import HomeBearing
from homeward.drives.landmarks import KnownLandmarks
from homeward.drives.robot import (
    Cameras,
    Home,
    known_home,
    known_landmarks,
    known_robot,
    known_settings,
    with_camera,
)
from homeward.drives.settings import DriveSettings, OtherCamera, Robot
from homeward.estimator import (
    CopyableLock,
    Counts,
    Estimate,
    Innovation,
    LandmarkEstimate,
    Status,
    guarded,
    synchronised,
)
from homeward.geometry.frames import Pose
from homeward.io.blas_threads import single_threaded_blas
from homeward.localizer.chart import Chart
from homeward.localizer.inputs.agreement import DeadOdometry, FrozenCameras, Plausibility
from homeward.localizer.inputs.bearing_noise import valid_sigma
from homeward.localizer.inputs.reorder import BearingFrame, ReorderBuffer
from homeward.localizer.inputs.sign_check import SignChecks
from homeward.localizer.map.ranges import RangeInput
from homeward.localizer.motion.odometry import lag_notes
from homeward.localizer.motions import HEAD
from homeward.localizer.output.faces import EstimatedCalibration, MapSnapshot, PredictedBearings
from homeward.localizer.recovery.monitor import has_other_scale
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.tunables import MAX_IN_VIEW, NOTABLE_RATIO, SIGN_LAGS_S, SWITCH_MARGIN
from homeward.odometry.history import Reckoned, TwistHistory
from homeward.odometry.validity import MAX_DELAY_S, Clock
from homeward.reasons import Reason, Rejection
from homeward.sighting_keys import is_unlabelled

if TYPE_CHECKING:
    from homeward.localizer.unlabelled.front import UnlabelledLandmarks

SCALE_NOTE = (
    "Distances have the error of the wheels' speed, often 4 %. One measured distance removes it: in"
    " landmarks.yaml of the drive folder, `distances: [{between: [ID, ID], distance: METRES}]`."
)
NOISY_NOTE = (
    "The bearings are noisier than given; larger standard deviations were used. Increase"
    " `bearing_sigma` under `sensor:` in drive.yaml; `homeward tune` estimates it."
)
DEFAULT_NOISE_NOTE = (
    "The camera noise was not given; at least {:g} rad was assumed. "
    "`homeward tune` estimates it: with the right `bearing_sigma` the first pose can come earlier."
)


class Localizer:
    """The robust localiser, an `Estimator`.

    Parameters
    ----------
    home : dict of str to float or HomeBearing
        Home bearings [rad] by landmark, some with standard deviations.
    settings : LocalizerSettings or dict, optional
        Everything else.
    known : KnownLandmarks or dict, optional
        A survey of landmarks, distances of pairs.
    **robot : Robot
        Description of the robot: `sensor`, `home_sensor`, `odometry`, `start`.

    Raises
    ------
    InputError
        If one of the arguments is not valid.
    """

    name = "robust"
    uses_cameras = True
    """Whether `bearings` takes ranges, and the name of a camera."""
    uses_sideways = True
    """Whether `odometry` takes a sideways speed."""
    uses_unlabelled = True
    """Whether `bearings` takes sightings without ids."""

    @single_threaded_blas()  # finding its libraries takes longer than a frame
    def __init__(
        self,
        home: Home,
        *,
        settings: LocalizerSettings | dict[str, Any] | None = None,
        known: KnownLandmarks | dict[str, Any] | None = None,
        **robot: Unpack[Robot],
    ) -> None:
        self.counts, self._turn = Counts(), CopyableLock()
        self.settings = known_settings(LocalizerSettings, settings)
        self._home, self._robot = known_home(home), known_robot(robot)
        self._cameras = Cameras(self._robot, (seen.camera for seen in self._home.values()))
        self._notes = (SCALE_NOTE,) if self._robot.odometry.speed_scale_sigma is None else ()
        self._known = known_landmarks(known)
        self._retained = 0.0
        """Time for which twists are kept at least [s]."""
        self._keeps = False
        self._blind: list[tuple[float, float]] = []
        self._clock = Clock()
        self._begin()

    def __copy__(self) -> Localizer:
        """Return an independent copy, as `copy.deepcopy` does."""
        return copy.deepcopy(self)

    def _begin(self) -> None:
        """Begin without samples and without a map."""
        self.twists = TwistHistory()
        """The newest twists, as accepted."""
        self.unlabelled: UnlabelledLandmarks | None = None
        """Landmarks without ids; None as long as all have one."""
        if any(map(is_unlabelled, self._home)):
            self.unlabelled = self._without_ids()
        self._chart = self._new_chart(self._robot, self.counts)
        if self._keeps:
            self._chart.retain_marginalised()
        self._candidate_chart: Chart | None = None
        """The second chart, begun when the robot was lost in the first."""
        self._candidate_lead = 0
        """How many more sightings fit the second, since it began or was last the worse one."""
        self._is_rescaled = False
        """Whether the second has another scale: wheels spin, and its distances are wrong."""
        self._reorder = ReorderBuffer()
        self._sign_checks = SignChecks(self._robot)
        self._plausibility, self._dead = Plausibility(), DeadOdometry()
        self._plausibility.count_bearings(seen.bearing for seen in self._home.values())
        self._frozen = FrozenCameras(self._robot)
        self._at_newest: set[tuple[str, float]] = set()
        """Sightings of the newest stamp of bearings."""
        self._t = -math.inf
        self._ranges = RangeInput(self._robot.sensor.range_sigma, self._known.is_given)

    @synchronised
    def restart(self) -> None:
        """Begin again in the middle of a drive, after an internal error: without a map.

        Settings, counts and known landmarks stay. The start prior was for another place, and is
        forgotten.
        """
        self._robot = self._robot.model_copy(update={"start": None})
        self._begin()

    @property
    @synchronised
    def notes(self) -> tuple[str, ...]:
        """Assumptions, and findings about the robot, by their usual effect on the answer."""
        if self.is_convention_wrong:
            home = self.chart.home.notes(self.chart.map) if self.chart.home.is_mirrored else ()
            return (*self._notes, *self._sign_checks.notes, *home)
        noise = self.chart.noise
        noisy: tuple[str, ...] = (NOISY_NOTE,) if noise.scale > 1.0 else ()
        if noise.learnt is not None and noise.learnt < self.settings.bearing_sigma / NOTABLE_RATIO:
            noisy += (DEFAULT_NOISE_NOTE.format(self.settings.bearing_sigma),)
        noisy += noise.correlated.notes(noise.sigma) + self.chart.process_noise.notes
        extrinsics, calibration = self.chart.extrinsics, self.chart.map.smoother.state.calibration
        survey = self.chart.map.registration.survey
        scale = (
            survey.notes(self.chart.map.smoother.state) if survey.known.is_given else self._notes
        )
        robot = *extrinsics.notes(calibration), *lag_notes(calibration)
        ranges = self._range_notes()
        wheels = *self._plausibility.notes, *self._dead.notes
        without_ids = () if self.unlabelled is None else self.unlabelled.notes
        return (
            *without_ids,
            *wheels,
            *robot,
            *self.chart.home.notes(self.chart.map),
            *ranges,
            *noisy,
            *scale,
        )

    def _without_ids(self) -> UnlabelledLandmarks:
        """Begin the identification of landmarks without ids, which few drives need."""
        from homeward.localizer.unlabelled.front import UnlabelledLandmarks

        return UnlabelledLandmarks(self._home)

    def _range_notes(self) -> tuple[str, ...]:
        """Return a note for the user on ranges, if any came."""
        smoother, counts = self.chart.map.smoother, self.chart.counts
        rejected = counts.rejected.get(Rejection.RANGE_OUTSIDE_GATE, 0)
        return self._ranges.notes(counts.ranges, rejected, *smoother.range_over_odometry)

    @guarded
    def odometry(self, t: float, v: float, omega: float, vy: float = 0.0) -> None:
        """Add a twist that holds from `t` [s] on: `v` [m/s] forward, `omega` [rad/s].

        `vy` [m/s] is the speed to the left of a robot that can move sideways.

        NaN for both `v` and `omega`: the motion is unknown until the next twist. A twist that is
        implausible, or that repeats zero while the bearings change, counts as one of unknown
        motion.
        """
        t = self._clock.read(t)
        if not math.isfinite(t):
            self._reject(Rejection.BAD_ODOMETRY)
            return
        late = self._is_too_late(t)
        self._reorder.odometry(t, late)
        if late:
            self._reject(Rejection.LATE_ODOMETRY)
            return
        if not self._plausibility.accepts(t, v, omega, vy):
            if not (math.isnan(v) and math.isnan(omega)):
                self._reject(Rejection.BAD_ODOMETRY)
            if not self.twists:
                return
            v = omega = math.nan
        self._dead.odometry(t, v, omega, vy)
        if self._dead.is_dead:
            v = omega = math.nan
        self._advance(t)
        if not self.twists and self._robot.start is None and not self._chart.map.landmarks.mapped:
            self._chart.begin(t)  # earlier motion is of no interest
        self.twists.add(t, v, omega, vy=vy)
        for chart in self.charts:
            chart.follow(t)
        needed = min(chart.needed_since for chart in self.charts)
        self.twists.forget(min(needed, self.twists.newest - self._retained))
        self._process_due()

    @guarded
    def bearings(
        self,
        t: float,
        sightings: Mapping[str, float] | Sequence[Any],
        sigmas: Mapping[str, float] | None = None,
        ranges: Mapping[str, float] | None = None,
        range_sigmas: Mapping[str, float] | None = None,
        camera: str = "",
    ) -> Estimate:
        """Add all sightings of stamp `t` [s]: bearing [rad] from the camera's axis by id.

        Without ids, they are a list of bearings, or of pairs of a class and a bearing. Mixed with
        ids, the key ``class:post``, or an empty one, has the list of their bearings.

        `camera` is the name of their camera in `cameras`; a robot with one camera needs none.

        Some may have a range [m] with a standard deviation [m], else `sensor.range_sigma` of it.

        If odometry is late, they wait for it, and the estimate is without them for now. A frame
        without sightings has no effect: the estimate is that of `estimate`.
        """
        assert isinstance(sightings, Mapping)  # as `guarded` converts it
        offset = self._cameras.in_first(camera)
        stamp, t = t, self._clock.read(t)
        if not math.isfinite(t) or t < self._reorder.newest or self._is_too_late(t):
            self._reorder.late_bearings()
            late = Rejection.LATE_BEARINGS if math.isfinite(t) else Rejection.BAD_BEARING
            self._reject(late, len(sightings))
            return self.estimate(stamp)
        self._plausibility.count_bearings(sightings.values())
        usable = {n: math.remainder(b, math.tau) for n, b in sightings.items() if math.isfinite(b)}
        if len(usable) < len(sightings):
            self._reject(Rejection.BAD_BEARING, len(sightings) - len(usable))
        usable = self._without_repeats(t, usable)
        if not usable:
            return self.estimate(stamp)
        if len(usable) > MAX_IN_VIEW:
            self._reject(Rejection.BEYOND_MAX, len(usable) - MAX_IN_VIEW)
            usable = self._select_in_view(usable)
        self._advance(t)
        given = {n: valid_sigma(s) for n, s in (sigmas or {}).items()}
        valid = {n: s for n, s in given.items() if math.isfinite(s)}
        frame = BearingFrame(t, usable, valid, camera=camera, offset=offset)
        if ranges:
            with_range, bad = self._ranges.usable(usable, ranges, range_sigmas)
            if bad:
                self._reject(Rejection.BAD_RANGE, bad)
            frame = frame._replace(ranges=with_range)
        self._reorder.bearings(frame)
        with_ids = {n: b for n, b in usable.items() if not is_unlabelled(n)}
        if len(with_ids) < len(usable) and self.unlabelled is None:
            self.unlabelled = self._without_ids()
        tracks = frame.by_camera(with_ids), frame.by_camera(valid)
        self._dead.bearings(t, *tracks, self.chart.noise)
        innovations = self._process_due()
        return self._estimate(t, innovations, stamp)

    @synchronised
    @single_threaded_blas()
    def replace_known(self, known: KnownLandmarks) -> None:
        """Replace the known landmarks by newer ones in the same frame.

        For a place that other robots changed. It must not contain measurements of this drive,
        which would count twice.
        """
        self._known = known
        for chart in self.charts:
            chart.replace_known(known, self._t)

    @synchronised
    def add_camera(self, name: str, camera: OtherCamera) -> bool:
        """Add the extrinsics of another camera, whose bearings come from now on.

        Return False, and change nothing, if there are bearings of that name already: then a new
        localiser is needed.
        """
        if name in self._robot.cameras or name in ("", self._cameras.first):
            return False
        self._robot = self._sign_checks.robot = with_camera(self._robot, name, camera)
        self._frozen.set_extrinsics(name, camera)
        self._cameras = Cameras(self._robot, [self._cameras.first])
        for chart in self.charts:
            chart.drive = with_camera(chart.drive, name, camera)
        return True

    @guarded
    def estimate(self, t: float) -> Estimate:
        """Predict to `t` [s], not before the last sample; nothing changes."""
        if self._t == -math.inf:
            return Estimate(t, Status.WAITING, Reason.NO_SAMPLES.words)
        at = self._clock.peek(t)
        now = max(at, self._t) if math.isfinite(at) else self._t
        return self._estimate(now, (), t)

    @guarded
    @single_threaded_blas()
    def landmarks(self) -> list[LandmarkEstimate]:
        """Return everything known of each landmark, in order of name."""
        return self.chart.landmarks(with_home=not self.is_convention_wrong)

    @property
    def is_convention_wrong(self) -> bool:
        """Whether the bearings of a camera contradict their sense of rotation or its yaw.

        Or those of home have the opposite sign. Then there is no pose.
        """
        return self._sign_checks.is_wrong or self.chart.home.is_mirrored

    @property
    def mount(self) -> Pose | None:
        """The estimated pose of the camera on the robot; None where it is as given or assumed."""
        return self.chart.extrinsics.estimate(self.chart.map.smoother.state.calibration)

    @property
    def chart(self) -> Chart:
        """The chart that answers: the second one where it alone has a pose."""
        candidate = self._candidate_chart
        if candidate is None or self._is_rescaled or self._chart.has_pose:
            return self._chart
        return candidate if candidate.has_pose else self._chart

    @property
    def charts(self) -> tuple[Chart, ...]:
        """All charts, the older one first."""
        candidate = self._candidate_chart
        return (self._chart,) if candidate is None else (self._chart, candidate)

    def retain_marginalised(self) -> None:
        """Keep all keyframes, for smoothing; memory then grows with the drive."""
        self._keeps = True
        self._chart.retain_marginalised()

    def retain_odometry(self, seconds: float) -> None:
        """Keep twists for a time [s], for smoothing with a fixed lag."""
        self._retained = seconds

    def drive_time(self, stamp: float) -> float:
        """Return the time [s] on the localiser's clock, which never runs back, of a stamp [s]."""
        return self._clock.peek(stamp)

    @property
    def spells_blind(self) -> list[tuple[float, float]]:
        """Intervals without an accepted bearing, after each of which a new map replaced one [s]."""
        return self._blind

    @guarded
    @single_threaded_blas()
    def predict(self, t: float, camera: str = "") -> PredictedBearings:
        """Predict the bearings of all mapped landmarks at `t` [s], not before the last sample.

        From one of the `cameras`, by its name; nothing changes.
        """
        offset, at = self._cameras.in_first(camera), self._clock.peek(t)
        return self.chart.predict(max(at, self._t) if math.isfinite(at) else self._t, offset)

    def calibration(self) -> EstimatedCalibration:
        """Return calibration and noise as estimated."""
        return self.chart.calibration

    def snapshot(self) -> MapSnapshot:
        """Return the present map by the measurements of this drive alone, and home in it.

        Raises
        ------
        numpy.linalg.LinAlgError
            When the measurements do not suffice.
        """
        chart = self.chart
        mapped = chart.map.landmarks.mapped
        state = chart.map.registration.measured(mapped.values())
        mean, covariance = state.positions, state.covariance[HEAD:, HEAD:]
        if chart.scale.rest is not None:
            covariance = covariance + chart.scale.rest**2 * np.outer(mean, mean)
        found, observed = chart.home.hypotheses, chart.home.observation
        known = found is not None and chart.has_pose and not chart.map.registration.has_home
        return MapSnapshot(
            tuple(mapped),
            mean,
            covariance,
            found.best.home if known and found is not None else None,
            observed.with_noise(chart.noise),
            observed.mounts(state.calibration),
        )

    def _select_in_view(self, sightings: dict[str, float]) -> dict[str, float]:
        """Return `MAX_IN_VIEW` sightings: of mapped landmarks first, then of those seen at home."""
        mapped = self.chart.map.landmarks.mapped
        order = sorted(sightings, key=lambda name: (name not in mapped, name not in self._home))
        return {name: sightings[name] for name in order[:MAX_IN_VIEW]}

    def _without_repeats(self, t: float, seen: dict[str, float]) -> dict[str, float]:
        """Return the sightings of stamp `t` [s] that did not come before: a bridge may repeat."""
        if t > self._reorder.newest:
            self._at_newest = set()
        new = {n: b for n, b in seen.items() if (n, b) not in self._at_newest}
        self._at_newest.update(new.items())
        if len(new) < len(seen):
            self._reject(Rejection.REPEATED_BEARINGS, len(seen) - len(new))
        return new

    def _reject(self, why: Rejection, number: int = 1) -> None:
        """Count samples that reach no map."""
        for chart in self.charts:
            chart.counts.reject(why, number)

    def _is_too_late(self, t: float) -> bool:
        """Return whether a sample of `t` [s] is too late to be used."""
        return t < self._t - MAX_DELAY_S or not all(c.odometry.accepts(t) for c in self.charts)

    def _process_due(self) -> tuple[Innovation, ...]:
        """Process the frames that need not wait; return the innovations of the newest."""
        innovations: list[Innovation] = []
        for frame in self._reorder.due(self.twists.newest, self._t):
            with single_threaded_blas():
                innovations = self._process(frame)
        return () if self._reorder.waiting else tuple(innovations)

    def _process(self, frame: BearingFrame) -> list[Innovation]:
        """Process a frame in each chart; return its innovations in the one that answers."""
        here = self.twists.at(frame.t)
        if self.unlabelled is not None:
            frame = self.unlabelled.identify(frame, here, self.twists, self.chart)
            if not frame.sightings:
                return []
        frozen = self._frozen.add_frame(frame.t, frame.sightings, frame.camera, here)
        if frozen:
            self._reject(Rejection.FROZEN, len(frozen))
            seen = {n: b for n, b in frame.sightings.items() if n not in frozen}
            frame = frame._replace(sightings=seen)
        if not frame.sightings:
            return []
        reckoned = self.twists.reckoned_at((frame.t - SIGN_LAGS_S).tolist())
        if reckoned is not None:
            is_lost = self._chart.monitor.is_lost
            self._sign_checks.bearings(frame.t, frame.camera, frame.sightings, reckoned, is_lost)
        innovations = self._chart.add_bearings(frame, here, self._t)
        if self.unlabelled is not None and self.unlabelled.after_frame(frame.t, self.chart):
            for chart in self.charts:
                chart.replace_home(self._named_home, self._t)
        if self._candidate_chart is not None:
            return self._update_candidate(self._candidate_chart, frame, here, innovations)
        if self._chart.monitor.fits_badly:
            self._begin_candidate(frame.t)
        return innovations

    def _update_candidate(
        self, candidate: Chart, frame: BearingFrame, here: Reckoned, before: list[Innovation]
    ) -> list[Innovation]:
        """Process a frame in the second chart; drop one chart once the other is proven.

        `here` is dead reckoning at its stamp, `before` its innovations in the first chart. Return
        the innovations in the chart that answers.
        """
        innovations = candidate.add_bearings(frame, here, self._t)
        maps = self._chart.map, candidate.map
        is_younger = maps[1].smoother.newest < maps[0].smoother.newest
        self._is_rescaled = is_younger and has_other_scale(*(m.landmarks for m in maps))
        gained = sum(i.accepted for i in innovations) - sum(i.accepted for i in before)
        self._candidate_lead = max(0, self._candidate_lead + gained)
        if self._candidate_lead >= SWITCH_MARGIN and self._is_sure(candidate):
            self._blind.append((self._chart.last_accepted, candidate.map.begun))
            self._chart, self.counts, self._candidate_chart = candidate, candidate.counts, None
            candidate.slipped_at = frame.t
        elif self._chart.monitor.fits_well and self._is_sure(self._chart):
            self._candidate_chart = None
        elif candidate.monitor.is_lost:
            self._begin_candidate(frame.t)
        return innovations if self.chart is candidate else before

    def _is_sure(self, chart: Chart) -> bool:
        """Return whether a chart has a pose to rely on."""
        is_wrong = self._is_rescaled and chart is self._candidate_chart
        return not is_wrong and chart.estimate(self._t).status is Status.LOCALISED

    def _begin_candidate(self, t: float) -> None:
        """Begin a second chart at the robot, at `t` [s]."""
        anywhere = self.chart.drive.model_copy(update={"start": None})
        self._candidate_chart = self._new_chart(anywhere, copy.deepcopy(self.counts))
        self._candidate_lead, self._is_rescaled = 0, False
        if self._keeps:
            self._candidate_chart.retain_marginalised()
        self._candidate_chart.begin(t)

    @property
    def _named_home(self) -> dict[str, HomeBearing]:
        """The home bearings whose landmarks are known, by landmark."""
        return self._home if self.unlabelled is None else self.unlabelled.home.named()

    def _new_chart(self, robot: DriveSettings, counts: Counts) -> Chart:
        """Return a new chart."""
        return Chart(self._named_home, robot, self.settings, counts, self.twists, self._known)

    def _advance(self, t: float) -> None:
        """Advance the time to `t` [s], unless it is there."""
        if self._t == -math.inf:
            self._chart.begin(t)
        self._t = max(self._t, t)

    def _estimate(self, t: float, innovations: tuple[Innovation, ...], stamp: float) -> Estimate:
        """Return the estimate at `t` [s], with the stamp `stamp` of the drive's own clock."""
        mirrored = Reason.HOME_MIRRORED if self.chart.home.is_mirrored else None
        if (why := self._sign_checks.reason or mirrored) is not None:
            return Estimate(stamp, Status.MAPPING, why.words, None, None, innovations)
        dead = self._dead.reason if self._dead.is_dead else None
        complaint = self._reorder.complaint or dead
        found = self.chart.estimate(t, innovations, complaint)
        found = self._with_doubt(found)
        if self._frozen.are_all_frozen:
            coasts = found.status is Status.LOCALISED
            status = Status.COASTING if coasts else found.status
            found = dataclasses.replace(found, status=status, reason=Reason.FROZEN.words)
        return found if t == stamp else dataclasses.replace(found, t=stamp)

    def _with_doubt(self, found: Estimate) -> Estimate:
        """Return an estimate with doubts about sightings and home bearings without ids."""
        if self.unlabelled is None:
            return found
        why = self.unlabelled.doubt
        if found.pose is None and self.unlabelled.home.why is not None:
            return dataclasses.replace(found, reason=self.unlabelled.home.why.words)
        if why is None or found.status not in (Status.LOCALISED, Status.COASTING):
            return found
        return dataclasses.replace(found, status=Status.UNVERIFIED, reason=why.words)

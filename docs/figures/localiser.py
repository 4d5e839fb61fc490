"""Ten figures of how the localiser works, of one run: `python docs/figures/localiser.py`.

All are of `homeward run sample --estimator robust,ekf`, and go to docs/images/localiser-N.png.
"""

from itertools import groupby
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import chi2

from homeward import make_estimator, open_drive, run
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, bearing, compose
from homeward.odometry.history import dead_reckoning
from homeward.runs.report.canvas import png, style
from homeward.runs.report.palette import BLUE, HOUSE, INK, MUTED, ORANGE, STATUS_COLOURS, VERMILLION

IMAGES = Path(__file__).resolve().parents[1] / "images"
SIZE_IN = (5.6, 3.2)
SEEN, EVERY = "L09", 12
"""The landmark whose sight lines are drawn: one of this number of sightings."""
BEYOND_M, RINGS = 1.0, 10
"""Length of sight lines beyond a landmark [m]; radius of the rings [sigma]."""
WINDOW = 60
"""Innovations in a mean."""


class Run:
    """The sample drive, and the tracks of two estimators."""

    def __init__(self):
        self.drive = open_drive("sample")
        self.track, self.ekf = (
            run(self.drive, make_estimator(n, self.drive)) for n in ("robust", "ekf")
        )
        self.moved = {m.landmark for m in self.track.landmarks if m.moved}
        self.mount = self.drive.settings.sensor.pose


def camera(sample, k):
    """Return the camera's pose in row k of the track."""
    t = sample.track
    return compose(Pose(t.x[k], t.y[k], t.heading[k]), sample.mount)


def colour_of(sample, landmark):
    """Return the colour of a landmark: whether it was moved."""
    return VERMILLION if landmark in sample.moved else BLUE


def plan(axes, sample):
    """Draw home, and metres alike on both axes."""
    axes.fill(*(np.array(HOUSE) * 0.18).T, fc="white", ec=INK, lw=1.5, zorder=4)
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.set_adjustable("datalim")


def odometry(axes, sample):
    """1: odometry alone, from the true start, against ground truth."""
    truth, odometry = sample.drive.truth, sample.drive.odometry
    start = Pose(truth.x[0], truth.y[0], truth.heading[0])
    alone = compose(start, dead_reckoning(odometry, odometry.t))
    axes.plot(truth.x, truth.y, color=INK, label="ground truth")
    axes.plot(alone.x, alone.y, color=ORANGE, label="odometry alone")
    axes.legend()


def sight_lines(axes, sample):
    """2: bearings of one landmark along the path."""
    s, track = sample.drive.sightings, sample.track
    axes.plot(track.x, track.y, color=MUTED, lw=0.8)
    (mark,) = (m for m in track.landmarks if m.landmark == SEEN)
    rows = np.flatnonzero(s.landmark == SEEN)[::EVERY]
    for t, seen in zip(s.t[rows], s.bearing[rows], strict=True):
        k = np.searchsorted(track.t, t)
        if track.has_pose[k]:
            eye = camera(sample, k)
            sight_line(axes, eye, seen, np.hypot(mark.x - eye.x, mark.y - eye.y) + BEYOND_M, BLUE)
    axes.plot(mark.x, mark.y, "o", color=INK)


def sight_line(axes, eye, seen, length, colour):
    """Draw a bearing from a camera."""
    way = eye.heading + seen
    end = eye.x + length * np.cos(way), eye.y + length * np.sin(way)
    axes.plot([eye.x, end[0]], [eye.y, end[1]], color=colour, lw=0.7)


def mapped(axes, sample):
    """3: all landmarks, with the uncertainty of their distances."""
    axes.plot(sample.track.x, sample.track.y, color=MUTED, lw=0.8)
    for m in sample.track.landmarks:
        if np.isfinite(m.x):
            axes.plot(m.x, m.y, "o", color=INK, ms=3)
            axes.add_patch(circle(m.x, m.y, RINGS * m.sigma_distance))
            axes.annotate(m.landmark, (m.x, m.y), (4, 3), textcoords="offset points", fontsize=7)


def circle(x, y, radius):
    """Return a circle to draw."""
    from matplotlib.patches import Circle

    return Circle((x, y), radius, fc="none", ec=BLUE)


def resection(axes, sample):
    """4: the stored home bearings, drawn from the estimated home."""
    for m in sample.track.landmarks:
        if m.landmark in sample.drive.home and np.isfinite(m.x):
            colour = colour_of(sample, m.landmark)
            length = np.hypot(m.x, m.y) + BEYOND_M
            sight_line(axes, sample.mount, sample.drive.home[m.landmark].bearing, length, colour)
            axes.plot(m.x, m.y, "o", color=colour, ms=4)
            axes.annotate(m.landmark, (m.x, m.y), (4, 3), textcoords="offset points", fontsize=7)


def residuals(axes, sample):
    """5: residual of each home bearing."""
    home = sample.drive.home
    tested = [m for m in sample.track.landmarks if m.landmark in home and np.isfinite(m.x)]
    seen = [home[m.landmark].bearing - bearing(sample.mount, m.x, m.y) for m in tested]
    off = np.degrees(wrap(np.array(seen)))
    axes.bar(
        [m.landmark for m in tested], off, color=[colour_of(sample, m.landmark) for m in tested]
    )
    axes.set(ylabel="residual of the home bearing [deg]")
    axes.tick_params(axis="x", labelsize=7)


def probability(axes, sample):
    """6: probability of each landmark to have moved, over time."""
    known = sample.track.history
    for k, name in enumerate(known.landmark):
        axes.plot(known.t, known.moved_probability[:, k], color=colour_of(sample, name), lw=1)
    axes.set(xlabel="time [s]", ylabel="probability to have moved")


def certainty(axes, sample):
    """7: uncertainty of the position, and the status."""
    track = sample.track
    sigma = np.sqrt(track.covariance[:, 0, 0] + track.covariance[:, 1, 1])
    axes.plot(track.t, sigma, color=INK)
    a = 0
    for status, rows in groupby(track.status):
        b = a + len(list(rows))
        left, right = track.t[a], track.t[min(b, len(track.t) - 1)]
        axes.axvspan(left, right, color=STATUS_COLOURS[status], alpha=0.35, lw=0)
        a = b
    axes.set(xlabel="time [s]", ylabel="sigma of the position [m]")


def innovations(axes, sample):
    """8: normalised innovations."""
    seen = sample.track.innovations
    ok = seen.accepted & np.isfinite(seen.sigma)
    nis = (seen.value[ok] / seen.sigma[ok]) ** 2
    mean = np.convolve(nis, np.ones(WINDOW) / WINDOW, "valid")
    axes.plot(seen.t[ok][WINDOW - 1 :], mean, color=BLUE)
    low, high = chi2.ppf([0.025, 0.975], WINDOW) / WINDOW
    axes.axhspan(low, high, color=MUTED, alpha=0.25, lw=0)
    axes.set(xlabel="time [s]", ylabel=f"NIS, mean of {WINDOW}", ylim=(0, 2))


def consistency(axes, sample):
    """9: error within three sigmas."""
    track, t = sample.track, sample.track.t
    off, sigma = track.x - sample.drive.truth.at(t).x, track.sigmas[:, 0]
    axes.fill_between(t, -3 * sigma, 3 * sigma, color=BLUE, alpha=0.2, lw=0)
    axes.plot(t, off, color=INK, lw=1)
    axes.set(xlabel="time [s]", ylabel="error in x [m]", ylim=(-0.6, 0.6))


def comparison(axes, sample):
    """10: the same drive with a filter that uses all home bearings."""
    for track, colour in ((sample.track, BLUE), (sample.ekf, ORANGE)):
        true = sample.drive.truth.at(track.t)
        off = np.hypot(track.x - true.x, track.y - true.y)
        axes.plot(track.t, off, color=colour, label=track.estimator)
    axes.legend()
    axes.set(xlabel="time [s]", ylabel="error [m]")


PLANS = (odometry, sight_lines, mapped, resection)
OVER_TIME = (residuals, probability, certainty, innovations, consistency, comparison)


def main():
    """Draw them all."""
    sample = Run()
    for number, draw in enumerate((*PLANS, *OVER_TIME), 1):
        with style():
            figure = Figure(figsize=SIZE_IN, layout="constrained")
            axes = figure.add_subplot()
            if draw in PLANS:
                plan(axes, sample)
            draw(axes, sample)
            (IMAGES / f"localiser-{number}.png").write_bytes(png(figure, dpi=110))


if __name__ == "__main__":
    main()

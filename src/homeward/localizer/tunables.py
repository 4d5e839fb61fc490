"""Tunables: every number of the localiser that affects its estimates, and why it has its value."""

from __future__ import annotations

from statistics import NormalDist


def sigmas(tests: int = 1) -> float:
    """Return the two-sided gate of n tests with a joint false-alarm rate of `FALSE_ALARM` [1]."""
    return NormalDist().inv_cdf(1.0 - 0.5 * FALSE_ALARM / tests)


# Statistical tests
FALSE_ALARM = 0.0027
"""Probability that a test rejects what is right: that of three standard deviations."""
INLIER = sigmas()
"""Gate of a single test, which costs one sighting [standard deviations]."""
GATE = sigmas(40)
"""Innovation gate: a landmark is tested at every keyframe of a window (Bonferroni correction)
[standard deviations]."""
FINAL_GATE = sigmas(5000)
"""Gate of final decisions: tested at every keyframe of 40 min [standard deviations]."""
MAJORITY = 0.6
"""Share that must agree: more than half, to leave room for outliers."""
RECENT = 10
"""Sightings that the kidnap detector and the relocalisation use: two of each of five landmarks,
recent enough for odometry to connect them."""
MIN_SIGHTINGS = 6
"""Sightings before anything is decided about a landmark: if half of them are wrong, three right
ones remain, and one of these checks the other two."""
ESTABLISHED = 2 * MIN_SIGHTINGS
"""Sightings at the old place, and again at the new one, before a landmark is declared moved."""
MAX_NOISE_RATIO = 1.5
"""Given standard deviations are overruled when residuals are more than so many times larger [1]."""

# Linearity of bearings, in turns and in shifts relative to the landmark distance
LINEAR = 0.3
"""Turns [rad] and shifts [landmark distance] up to which a bearing is linear: tan is, to 3 %."""
CLOSE = LINEAR / 3
"""A third of that is linear to 0.3 %, since the error goes with the square: two places so close are
one [landmark distance]."""
NEGLIGIBLE = LINEAR / 10
"""A tenth of that is linear to 0.03 %: corrections up to this need no relinearisation."""
STANDSTILL = 0.01
"""Motion below which the robot counts as standing still: half the default bearing noise [rad,
landmark distance]."""
VAGUE = 0.7
"""Odometry less certain than this cannot predict bearings [rad, landmark distance]; a bearing
inflated by so many of its standard deviations has lost a third of its information."""

# Bearings that determine and verify a pose
MINIMAL = 3
"""Bearings that determine a pose (geometry, not a choice): any three fit some pose."""
VERIFIED = MINIMAL + 2
"""Bearings that verify a pose: two beyond the three that determine it."""

# Landmark initialisation and motion
BASELINE = 5.0
"""A landmark is triangulated once the baseline is this many times the uncertainty of odometry along
it, so that this turns sight lines by at most a fifth of the parallax. While nothing is mapped,
motions less certain than that are not used."""
MARGIN = 1.5
"""A triangulated position must explain this many sight lines more than any rival: more than one
line that fits by chance."""
RIVAL_SHARE = 0.67
"""Positions this far apart are rivals: nearer than 0.6 or farther than 3 times the distance
[distance]."""
WALKING_PRIOR = 0.01
"""Prior probability that a landmark walks about while it is observed [1]."""
SWAP_RATIO = 2.0
"""Identities count as swapped if another landmark's residuals are less than this many times larger
[1]."""

# Home
UPHEAVAL = 0.1
"""Prior probability that a place was rearranged: then any share of landmarks may have moved [1]."""
OUTLIER_SIGMA = 0.5
"""Standard deviation of an outlier home bearing, for the half of moved landmarks that were pushed;
the others may be anywhere on the circle [rad]."""
GIVEN_WRONG = 0.01
"""Prior probability that the given standard deviation of the home bearings is wrong, that a given
start is, and that a camera is elsewhere than assumed: in one of a hundred drives each [1]."""
NOISE_SCALES = (3.0, 10.0)
"""Factors by which that standard deviation may be wrong: half a decade tells one noise level from
another [1]."""
HOME_DISTANCE = 0.5
"""Typical distance of home from the centre of its landmarks: among them [range]."""
MAX_RANGE = 20.0
"""Largest distance of home [extent of the landmarks]: from there all of them are within 3 deg, the
noise of one or two bearings."""
MIN_INFORMATION_SHARE = 0.002
"""Share of the information on home that is kept when the spurious part is removed [1]."""
IMPROBABLE = 1e-3
"""Hypotheses this much less probable than the best are dropped, and flips to such are not tried:
fifty of them together stay below what the setting `sure` leaves open."""
FIX_HYSTERESIS = 2.0
"""Hysteresis: a published pose is withdrawn when this many times less certain than required at
first."""

# Odometry
INFLATION = 3.0
"""The gate inflates the standard deviation of odometry by this factor, since wheels slip and robots
are bumped."""
CALIBRATION_DRIFT = 0.5 / 60.0
"""Random walk of the calibration: half of its a priori deviation in an hour, by tyres and batteries
[1 / sqrt(s)]."""
SPEED_TIME_S, TURN_TIME_S = 1.0, 0.5
"""Correlation times of speed and turn rate during an odometry dropout [s]."""
MIN_SPEED, MIN_TURN_RATE = 0.3, 0.3
"""Lower bounds on the usual speed [m/s] and turn rate [rad/s], however little the robot has moved.
"""
MEMORY_S = 60.0
"""Averaging time of the usual speed, counted while moving: one wild twist hardly changes it [s]."""
NOISE_PRIOR = 2.0
"""Weight of the prior on the odometry noise, in motions: it is an order of magnitude only [1]."""
USUAL_DISTANCE_M = 3.5
"""Landmark distance from which on that prior holds, as in a room [m]."""
NOISE_MEMORY = 200.0
"""Keyframes over which the odometry noise is averaged, two minutes of driving: floors differ [1].
"""

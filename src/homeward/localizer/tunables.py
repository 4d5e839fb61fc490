"""Tunables: every number of the localiser that its answers depend on, and why it is what it is.

What a user may want to set is in `settings`. Capitals of other modules are numerics: how often,
how many at most, how small; they buy time or keep arithmetic sound, and are no matter of belief.
Lengths are in distances of landmarks: the median one of those that are mapped.
"""

from __future__ import annotations

from statistics import NormalDist


def sigmas(tests: int = 1) -> float:
    """Return the two-sided gate of so many tests that together err with `FALSE_ALARM` [1]."""
    return NormalDist().inv_cdf(1.0 - 0.5 * FALSE_ALARM / tests)


# Tests of what is seen
FALSE_ALARM = 0.0027
"""Probability that a test doubts what is right: that of three standard deviations."""
AGREES = sigmas()
"""What is off by more does not agree: one test, which costs one sighting [standard deviations]."""
GATE = sigmas(40)
"""What is off by more is rejected: a landmark is tested at all keyframes of a window (Bonferroni)
[standard deviations]."""
DENIED = sigmas(5000)
"""What is off by more is denied for good: tested at each keyframe of 40 min [standard deviations].
"""
MAJORITY = 0.6
"""So large a share of all must agree: most of them, with some to spare for outliers."""
RECENT = 10
"""The last so many sightings tell whether the map fits, and where else the robot may be: two of
each of five landmarks, while odometry still ties them together."""
ENOUGH = 6
"""From so many sightings on something is said of a landmark: with half of them wrong, three right
ones are left, of which one checks the other two."""
ESTABLISHED = 2 * ENOUGH
"""That a landmark moved is said after so many at its old place, and as many at its new one."""
EXCESSIVE = 1.5
"""Given deviations, of bearings and of motions, are doubted where the map leaves so many times more
[1]."""

# How large is small: a bearing is linear in what is small against the distance of the landmark
LINEAR = 0.3
"""Bearings are linear in turns [rad] and shifts [distance] up to this: tan is, to 3 %."""
CLOSE = LINEAR / 3
"""... and here to 0.3 %, as that goes with the square: two places so near to each other are one
[distance]."""
TINY = LINEAR / 10
"""... and here to 0.03 %: so much is corrected without solving anew."""
STANDS = 0.01
"""A robot that moved less stands: half the noise of a bearing, as it is believed at first."""
LOST = 0.7
"""A motion less certain than this [rad, distance] tells nothing of bearings; nor does a bearing
that is blurred so much by its way [standard deviations]: a third of what it told is gone."""

# What checks what
POSE = 3
"""So many bearings fix a pose, and fit some pose always; geometry, no choice."""
PROOF = POSE + 2
"""From a place from which so many (more) fit the robot sees them: two check a pose of three."""
FOUND = 0.7
"""... and so large a share of all it saw: a larger one than `MAJORITY`, as three always fit [1]."""

# Landmarks enter, move and go
BASE = 5.0
"""They start from a base so many times longer than odometry's uncertainty about it, which then
turns sight lines by a fifth of the parallax at most; and before any is mapped a way less certain
than that is not looked at."""
MARGIN = 1.5
"""A place explains so many lines more than any other: one that is right by chance does not do."""
RIVAL_SHARE = 0.67
"""Another place is so far off, of its own distance: nearer than 0.6 or farther than 3 times [1]."""
WALKS = 0.01
"""One landmark in a hundred is on its way while it is looked at, as a rule [1]."""
AS_WELL = 2.0
"""Where another landmark is off by less than so many times as much, it is that one."""

# Home
UPHEAVAL = 0.1
"""Of the places that are come back to one in ten was rearranged: any share may have moved [1]."""
PUSHED = 0.5
"""Half of the landmarks that moved were pushed by about so much, seen from home; the other half was
carried anywhere [rad]."""
NOISE_DOUBT = 0.01
"""The deviation of home bearings is wrong in one of a hundred homes, ..."""
NOISIER = (3.0, 10.0)
"""... as they are by so many times: half a decade tells one noise from another [1]."""
HOME_SHARE = 0.5
"""Home is about so far from the middle of its landmarks: among them [of their range]."""
REACH = 20.0
"""... and not so many times farther from them than they are from each other: from there all of them
are within 3 deg, the noise of a bearing or two."""
LEAST_SHARE = 0.002
"""So much of the information on home is left when errors of the map are taken out [1]."""
NEGLIGIBLE = 1e-3
"""A hypothesis so many times less probable than the best one is dropped, and a flip that leads to
one is not tried: fifty of them stay below what `sure` leaves open."""
STILL_FIXED = 2.0
"""A pose that was given is given until it is so many times less certain than it had to be."""

# Odometry
HEAVY_TAIL = 3.0
"""Wheels slip and robots bump: the gate takes odometry for so much worse than its noise says."""
DRIFT = 0.5 / 60.0
"""The calibration drifts by half of its a-priori deviation in an hour, as a random walk: tyres and
batteries [1 / sqrt(s)]."""
SPEED_LASTS_S, TURN_LASTS_S = 1.0, 0.5
"""Without odometry it goes on for about so long at the speed, and turn rate, that it has [s]."""
SLOWEST, SLOWEST_TURN = 0.3, 0.3
"""It may be so fast [m/s], and turn so fast [rad/s], however little it moved before."""
LATELY_S = 60.0
"""What is usual is the mean over so much time of moving, which one wild twist spoils little [s]."""
NOISE_PRIOR = 2.0
"""What is believed of odometry's noise at first counts as so many motions: it is little more than a
guess at the order of magnitude [1]."""
USUAL_DISTANCE_M = 3.5
"""... for a robot among landmarks so far away, or farther: in a room [m]."""
NOISE_MEMORY = 200.0
"""So many keyframes count for it, two minutes of driving: floors differ [1]."""

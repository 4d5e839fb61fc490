"""Tunables: every number of the localiser that affects its estimates, and why it has its value.

A test checks that no other module of the localiser defines one.
"""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np
from scipy.special import chdtri


def sigmas(tests: int = 1) -> float:
    """Return the two-sided gate of n tests with a joint false-alarm rate of `FALSE_ALARM` [1]."""
    return NormalDist().inv_cdf(1.0 - 0.5 * FALSE_ALARM / tests)


# Statistical tests
FALSE_ALARM = 0.0027
"""Probability of a false rejection by a test: that of three standard deviations."""
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
USUAL_FIT = 0.9
"""Probability that a sighting fits, if the robot is where the map has it, and that one does not, if
it is elsewhere: one in ten ids is wrong where markers are read badly [1]."""
MIN_SIGHTINGS = 6
"""Sightings before anything is decided about a landmark: if half of them are wrong, three right
ones remain, and one of these checks the other two."""
ESTABLISHED = 2 * MIN_SIGHTINGS
"""Sightings at the old place, and again at the new one, before a landmark is declared moved; also
the fewest frames in which the bearings of a camera are compared with odometry that is zero."""
MAX_NOISE_RATIO = 1.5
"""Given standard deviations are overruled if residuals are larger by more than this factor [1]."""

# Linearity of bearings, in turns and in shifts relative to the landmark distance
LINEAR = 0.3
"""Turns [rad] and shifts [landmark distance] up to which a bearing is linear: tan is, to 3 %."""
CLOSE = LINEAR / 3
"""A third of that is linear to 0.3 %, since the error goes with the square: two places so close are
one [landmark distance]."""
NEGLIGIBLE = LINEAR / 10
"""A tenth of that is linear to 0.03 %: corrections up to this need no relinearisation."""
SAME_BEARINGS = 0.02
"""Homes this close are one: their bearings differ by no more than the default noise of one bearing
[rad, landmark distance]."""
STANDSTILL = 0.01
"""Motion below which the robot counts as standing still: half the default bearing noise [rad,
landmark distance]."""
VAGUE = 0.7
"""Odometry less certain than this cannot predict bearings [rad, landmark distance]; a bearing
inflated by this many of its standard deviations has lost a third of its information."""

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
BODY_M, ONE_BODY = 0.5, 0.5
"""Landmarks within the size of a box [m] move as one with this probability [1]: as likely as not,
they are on one object."""
SWAP_RATIO = 2.0
"""Identities count as swapped if another landmark's residuals are less than this many times larger
[1]."""

# Home
UPHEAVAL = 0.1
"""Prior probability that a place was rearranged: then any share of landmarks may have moved [1]."""
EXCHANGED = 0.02
"""Prior probability that a survey, or the bearings of a home, has two landmarks exchanged: two of
some ten public data sets that were examined have it, but most users check more carefully [1]."""
NUM_NEIGHBOURS = 3
"""Sets tried next to the best one: by the least decided flips, and by the exchanges that leave the
smallest errors."""
OUTLIER_SIGMA = 0.5
"""Standard deviation of an outlier home bearing, for the half of moved landmarks that were pushed;
the others may be anywhere on the circle [rad]."""
GIVEN_WRONG = 0.01
"""Prior probability that the given standard deviation of the home bearings is wrong, that a given
start is, that a camera is elsewhere than assumed, and that bearings have the wrong sense of
rotation: in one of a hundred drives each [1]."""
NOISE_SCALES = (3.0, 10.0)
"""Factors by which that standard deviation may be wrong: half a decade distinguishes noise levels
[1]."""
HOME_DISTANCE = 0.5
"""Typical distance of home from the centre of its landmarks: among them [range]."""
MAX_RANGE = 20.0
"""Largest distance of home [extent of the landmarks]: from there all of them are within 3 deg, the
noise of one or two bearings."""
MIN_INFORMATION_SHARE = 0.002
"""Share of the information on home that is kept when the spurious part is removed [1]."""
HOME_ROUNDING = 1e-6
"""Smallest share of a variance that remains when home is known, above rounding [1]."""
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

# Chart and localiser
RESECTION_S = 2.0 * SPEED_TIME_S
"""Without odometry for this long, nothing is known of the velocity, and each pose is a resection
from the survey, where the frame allows one [s]."""
SLIP_MEMORY_S = 300.0
"""For this long after bearings have denied a motion, wheels are expected to slip again: a robot
passes the same spot of the floor several times [s]."""
SLIP_SHARE = 1.0 / 3.0
"""Standard deviation of a motion that may be a slip, as a share of it: three of them contain wheels
that spin on the spot [1]."""
MAX_IN_VIEW = 100
"""Sightings used of a frame. Its cost grows with their number times the square of that of mapped
landmarks, and a pose from 500 bearings is 2.2 times as accurate as one from 100 at most."""
SWITCH_MARGIN = 20
"""A map is better if this many more sightings fit it; where both are right, as many fit both."""

# Fit and search of home
SAME_HOME = 1.0
"""Homes closer than this are the same [standard deviations]."""
CUT_SHORT = 0.999
"""A step longer than this was limited [of the longest step]."""
MAX_LAST_STEP = 0.5
"""Longest last step of a converged fit [standard deviations]."""
MAX_FIT_STEPS = 6
"""Gauss-Newton steps of a fit of home, and of a triangulation from lines that agree: most converge
in three or four; one that has not by then does not."""
FIT_CONVERGED = 1e-4
"""Smallest step that continues the iteration [of the longest step]."""
MAX_SEEDS = 8
"""Different sets from which a local search starts."""
MAX_FLIPS = 12
"""Largest number of flips from one seed."""
UNDECIDED = -math.log(IMPROBABLE)
"""Hypotheses whose log evidence falls short of the best by more are dropped, and flips that cost
more are not tried."""
PROBABLE = 0.05
"""Only sets more probable than this are flipped further when the map changes."""
FIXED_SIGMA = 1e-4
"""Standard deviation of home where it is the origin of a survey, floor of that of a start prior [m,
rad], and that of the position of fixed extrinsics [m]."""
MAX_HOME_STEP = 0.2
"""Longest step of home in a fit [range] ..."""
MAX_HOME_TURN = 1.0
"""... and largest turn [rad]."""
MAX_TRIPLES = 600
"""Largest number of triples; if there are more, they are drawn with a fixed seed."""
CLOSE_STEPS = 3
"""Steps of an iteration that begins close to its end: a pose from several cameras, where each step
divides the error by the distance of the landmarks over that of the cameras, and an alignment, which
begins at the solution for uncorrelated coordinates."""
SEARCH_EVERY = 40
"""Keyframes between two searches from scratch ..."""
SEARCH_PATIENCE = 10
"""... and by how many a search waits for a keyframe without other long work."""
MAX_SEEDS_IN_DOUBT = 4 * MAX_SEEDS
"""Seeds of a search while home is ambiguous: at one per keyframe, it lasts as long as the interval
between searches."""

# Checks and noise of the inputs
MIN_RESIDUALS = 40
"""Residuals, or pairs of them for a lag, needed for an estimate from the map ..."""
NUM_DIFFERENCES = 20, 200
"""... second differences needed for one without it, and how many of the latest are used."""
MAX_SPAN_S = 1.05
"""Longest time from the first to the third sighting of a second difference: beyond, directions are
not linear in time [s]."""
MIN_BEARING_SIGMA = 1e-6
"""Smallest plausible standard deviation; a smaller one counts as not given [rad]."""
NOISE_KEPT, CORRELATION_KEPT = 0.9, 0.97
"""Forgetting factors per keyframe, of the noise and of the correlation of errors [1]. The latter is
slower, since a wrong camera position causes correlated errors, too, until it has been estimated."""
MAX_INFLATION = 1.1
"""Noise is estimated from sightings whose standard deviation odometry inflates no more than this
[1]."""
MAX_RESIDUALS = 300
"""Latest residuals used for the noise scale: a camera may become worse during a drive."""
MAX_IDS = 2000
"""Ids kept without a look at their age; a front-end whose ids roll brings new ones without end."""
LAG_BOUNDS_S = np.array([0.02, 0.15, 0.4, 1.0, 2.5, 6.0, 15.0])
"""Bounds of the classes of time lag between paired sightings [s]."""
CORRELATION_TIMES_S = np.geomspace(0.1, 20.0, 24)
"""Correlation times that are tried [s]."""
PAIR_STEPS = (1, 2, 3, 5, 8, 13, 21, 34, 55)
"""Each sighting is paired with the k-th one after it of the same landmark."""
NOTABLE_GAP_S = 0.5
"""A note reports where a sighting this long after the last one counts for half [s]."""
MIN_GAP_S = 1e-3
"""Shortest time between two sightings of a landmark [s]."""
DEAD_WINDOW_S = 10.0
"""Length of a window in which bearings are compared: a slow robot moves notably in it [s]."""
MAX_NEUMANN_RATIO = 0.5
"""Largest ratio of successive squares to the variance of a smooth change [1]: of six independent
errors, about 1 in 300 gives a smaller one; of white noise the mean is 2."""
MIN_DISTANCE_M, MAX_DISTANCE_M = 0.1, 100.0
"""Distances between which landmarks may be [m]: from a farther one a robot has no parallax."""
MAX_RESOLUTION, BEARING_ROUNDING = 0.1, 1e-9
"""Resolution of bearings until a smaller step was seen; a still smaller one is rounding [rad]."""
ODOMETRY_ERROR, HEADING_RATE = 0.1, 0.02
"""Systematic error of odometry as a share of shift and rotation [1], and a heading error that grows
with the square root of time [rad/sqrt(s)]: twice what uncalibrated wheels have."""
REPEAT_MEMORY_S = 5.0
"""A landmark not seen for this long is forgotten [s]."""
FROZEN_S = 0.5
"""A camera is frozen, or odometry contradicted, once bearings have stayed for this long [s]:
odometry may lag that much behind a camera when the robot stops. A shorter change may be an outlier.
"""
NUM_CHANGES = 9
"""Latest changes between twists: their median is by noise, even if four are wrong."""
MIN_INTERVAL_S = 0.1
"""Shorter intervals count as this long: the noise of a speed grows as its interval shrinks [s]."""
START_S = 1.0
"""The robot is assumed to have been at rest this long before the first twist [s]."""
REORDER_WAIT_S = 10.0
"""Time for which bearings keep waiting after odometry has arrived later than bearings [s]."""
MIN_SAMPLES = 10
"""Samples needed before it is reported that most come late."""
YAW_STEP = math.radians(15.0)
"""Spacing of the yaws that are compared [rad]."""
YAW_TOLERANCE, YAW_TOLERANCE_OFF_CENTRE = 1, 2
"""Yaws up to this number of steps from the assumed one count as right: 15 degrees, which the map
estimates. It is 30 degrees where x or y of the camera are not given: a camera off the robot's
centre moves in another direction than the robot."""
SIGN_WINDOW_S, SIGN_MAX_TURN = 4.0, 1.0
"""A window ends after this time [s] or rotation [rad]: long enough for parallax, and so short that
odometry drifts by less than the noise."""
SIGN_MIN_PATH, SIGN_MIN_TURN = 0.1, 0.3
"""A window counts if the camera moved this far [m] or the robot turned this far [rad]: the noise of
odometry of a stationary robot is smaller, and fits any yaw."""
STAYING_SHARE = 0.3
"""A window does not count if the bearings change by less than this share of the rotation: the robot
is stationary while its wheels spin, or the camera is frozen. Landmarks that all are as near as the
centre of the bend would do the same [1]."""
SIGN_MAX_SIGHTINGS = 5_000
"""Sightings of a window that are kept, which bounds memory and cost."""
SIGN_MIN_KEPT = 12
"""Of a landmark with at least twice as many sightings in a window, every k-th is used, but at least
this many: three for each independent error (`NUM_INDEPENDENT_ERRORS`)."""
SIGN_NOISE = 0.02
"""Standard deviation of a bearing from the geometry of a window, drift included [rad]."""
NUM_INDEPENDENT_ERRORS = 4.0
"""Number of independent errors of a landmark in a window: those of odometry are correlated."""
BAD_WINDOW = 0.1
"""Probability that a window is evidence for nothing: slip, people [1]."""
SIGN_LAGS_S = np.array([0.0, 0.25, 0.5])
"""Lags of the bearings that are compared, equally probable [s]: in changing turns, a lag looks
like a wrong yaw."""
SIGN_TURN_SCALES = 2.0 ** np.linspace(-1.0, 1.0, 15)
"""Scales of the odometry's yaw rate that are compared [1]: beyond a factor of 2 a unit is wrong.
Half a step is an error of 0.05 rad in a window that turns by `SIGN_MAX_TURN`, of which 0.014 rad
remain about its mean: less than `SIGN_NOISE`."""
TURN_SCALE_OTHER = 0.1
"""Prior probability that the scale is not 1 but for the usual error, and may be any of these: that
of one in eleven real drives is 0.62, where odometry is the commanded twist [1]."""
SIGN_FALSE_ALARM = 1e-4
"""The convention is rejected once its posterior probability is below this [1]."""
SIGN_DOUBTFUL = 0.1
"""There is no pose while that probability is below this, if x and y of the camera are given: else
an unknown place of the camera can look like a yaw for some windows [1]."""
MIN_PROBABILITY = 1e-9
"""No hypothesis becomes less probable, so that a few windows suffice to reconsider [1]."""

# Map
MAX_PADDING = 8
"""Groups are padded to the largest, unless that takes this many times the memory [1]."""
VARIANCE_ROUNDING = 1e-10
"""Smallest share of the largest variance of innovations, above rounding [1]."""
MAX_TRIALS = 6
"""Candidates triangulated per keyframe."""
RETRY_GROWTH = 1.1
"""A failed candidate is tried again once it has this many times more sightings."""
LONG_WINDOW = 7500
"""Keyframes times landmarks from which a window that waits for parallax is too long: the longest
one with the landmarks of a room, fewer keyframes in a hall."""
LONG_DRIVE = 4000
"""Largest number of keyframes that are all solved again where the map has turned: half an hour with
two a second; the solution takes about a second."""
LONG_IN_A_ROOM = 500
"""The same where no landmark has left the view: the whole map is in the window."""
MIN_IDLE = 16
"""Landmarks out of view that are made passive at a time: with fewer, solutions take no longer."""
COMMON_DIRECTIONS = 96
"""Common errors of passive landmarks that are kept: the map bends and turns in fewer ways than
that, and the rest is smaller than the noise of a bearing."""
COMMON_SPARE = 32
"""How many more may come before they are reduced to those."""
WINDOW_S = 120.0
"""Longest window of keyframes [s]. Older candidates are dropped where ids come without end, and
older motions are not integrated again, which bounds the twists that are kept."""
ODOMETRY_EVERY = 10
"""Keyframes between two updates of the odometry noise."""
MIN_GAIN = 1e-6
"""Smallest gain of log posterior that counts, above rounding."""
MAX_PER_KEYFRAME = 12
"""Maximum sightings of a landmark per keyframe; more add nothing while the robot is stationary."""
EVALUATIONS_PER_WINDOW = 8
"""Evaluations of a solution per window, once it is full: learning from one takes longer than the
solution, and its results change slowly."""
EVALUATED_AFTER_DENIAL = 2
"""Keyframes from one evaluation to the next, for a window after bearings have denied a motion: a
robot with a knocked camera should not drive far."""
MIN_RANGE_RATIO, MAX_RANGE_RATIO, NUM_RANGES = 0.1, 30.0, 24
"""Ranges tried, over the median distance of the mapped landmarks; geometric, all equally probable.
"""
RANGE_STEPS = 2
"""Gauss-Newton steps of a direction: the residuals are nearly linear in it."""
MAX_SOLVE_STEPS = 5
"""Largest number of Gauss-Newton steps: most solutions need one, from the last one."""
RANGE_CORRELATION_S = 10.0
"""Correlation time of the errors of ranges [s], or as long as the landmark has been in view if that
is longer: on five real drives with barcodes the correlation is 0.9 after 0.5 s, 0.4 after 6 s and
0.25 after 25 s, by edges, viewing angle and distance."""
RANGE_ERROR, RANGE_ERROR_M = 0.05, 0.05
"""Standard deviation of a range without its own: relative [1], and at any distance [m]. On these
drives it is 0.02 to 0.05 of the range."""
FIXED_SPEED_SCALE = 1e-5
"""Standard deviation of the speed scale where nothing observes it [1]: negligible, but the scale of
ranges is a multiple of it."""
UNKNOWN_RANGE_SCALE = 1.0
"""Standard deviation of the logarithm of an unknown scale of ranges [1]: feet, or a tag of another
size, are within 1.2 deviations. With 0.1, these gave wrong poses until the robot had moved."""
MIN_SPEED_SCALE = 1e-3
"""Smallest standard deviation of the speed scale where ranges are used: no wheel is known better
[1]."""
MIN_RANGE_SIGMA, MAX_RANGE_SIGMA = 0.005, 1.0
"""Bounds on the relative standard deviation of a range: no detector of tags is better [1]."""
MIN_STEADY_SPEED = 1e-9
"""Mean speeds below it are zero but for rounding, which has no direction [m/s]."""
MIN_SIDEWAYS_SHARE = 0.1
"""Smallest mean speed sideways of a robot that strafes, as a share of that ahead [1]."""
INTERVAL_OF_SIDEWAYS = 0.5
"""Share of the time between keyframes for a robot whose odometry has noise to its side, too [1]:
frames between keyframes lose their information on its pose twice as fast."""
MIN_CALIBRATION_SIGMA = 1e-6
"""Smallest prior standard deviation of the calibration of odometry and of the camera's yaw."""
NEGLIGIBLE_CALIBRATION = 1e-4
"""Negative slip [m], time constant and delay [s] that are negligible."""
STALE_S = 0.02
"""Change of delay or time constant from which motions are integrated again [s]: at a fast turn rate
of 1 rad/s, its second-order effect on a heading is below the noise of a bearing."""
SOLVE_CONVERGED = 2e-2
"""Largest step at convergence [landmark distance, rad]; the rest goes as its square."""
MAX_TESTED = 48
"""Most landmarks of home or of a survey that are tested together, the oldest ones, which are the
nearest: the cost goes with the cube of their number."""
MIN_JUMP_EVIDENCE = math.log(1.0 / GIVEN_WRONG - 1.0)
"""Log Bayes factor from which a knocked camera is more probable than not, if one of a hundred turns
that odometry denies is the camera's [1]."""
NUM_JUMPS = 10
"""Motions whose turns odometry denies most, at each of which the camera may have been knocked: a
bump also moves the robot, and a wheel may slip now and then."""
NUM_SCALE_CHANGES = 24
"""Motions at which odometry may have changed: it is tested every few keyframes."""
MIN_CHANGED = 3
"""Motions after a change before it is tested: a slip is a change in one or two."""
MIN_SCALE = 0.1
"""Smallest scale of the speed after a change [1]: wheels that turn ten times too fast have no
grip."""
MIN_CHANGE = 0.15
"""Smallest change of the odometry's scale that is not drift: three standard deviations of the
calibration of a robot [1]."""
VAGUE_DATUM = 10.0
"""Prior standard deviation of the datum [size of the survey; rad]."""
ONE_PLACE = 1e-6
"""Information on the heading of a survey whose landmarks all coincide [1 / rad^2]."""
MIN_LINES = 3
"""Smallest number of lines that agree."""
MAX_LINES = 24
"""Lines, evenly spread, that are intersected in pairs."""
INFINITY_RATIO = 100.0
"""Distance used as infinity, relative to the distances at hand [1]."""

# Motion
ADVANCE_S = 0.5
"""TwistHistory are integrated at least this often [s]."""
STRAIGHTEST_SHARE = 0.2
"""Share of the path that counts as the straightest [1]."""
INITIAL_STRAIGHT_M = 1.0
"""Length of straight path assumed before the start [m]."""
NOTABLE_LAG_S = 0.15
"""Lag that a note reports [s]: if it is the bearings that are stamped wrong, poses have errors of
7 cm and 4 deg at 0.5 m/s and 0.5 rad/s."""
BRIDGED = 0.1
"""Standard deviation of the motion beyond `TWIST_VALIDITY_S` of a slow twist, over that motion:
robots mostly keep their speed; where this one does not, the residuals of the map raise its noise
further [1]."""
MEAN_S = 0.07
"""Averaging time of a twist [s]: longer than a sample, so that their noise is averaged, and shorter
than the robot takes to accelerate."""
MAX_LAG_S = 0.8
"""Largest plausible lag [s]."""
MEMORY_OF_LAG_S = 5.0 * MAX_LAG_S
"""How long before a motion twists act on it: twice the delay (it may change by as much), and three
time constants of a first-order lag [s]."""
FIXED_TIME_CONSTANT_S = 0.005
"""Prior standard deviation of the time constant while it is fixed at zero [s]: what a robot drives
in that time is below the noise of bearings."""
LAG_GATE = 2.0
"""Gate at which it is estimated, and motions are integrated again [standard deviations]: many
robots lag, and a false alarm costs little, as the estimate then has its prior around zero."""
BEND, NUM_BENDS = 0.125, 33
"""Width [rad/m] and number of the classes of turn per metre into which the path is sorted."""
NOTABLE_RATIO = 2.0
"""Ratio of standard deviations that a note reports [1]."""
MAX_NARROW = 2.0
"""Span of home bearings up to which a note asks for a turn at home [rad]: that of one look of a
camera of 115 degrees."""
NOTABLE_HEADING = 0.02
"""Standard deviation of the heading of home from which that note is of use [rad]."""

# Output
UNSEEN_S = 2.0
"""A reference frame of which no landmark is in sight is kept for this long [s]."""
MAX_CENTRE_STEPS = 20
"""Largest number of steps of the iteration for the centre of hypotheses; few need more than ten."""
CENTRE_CONVERGED = 1e-3
"""Step at which the iteration for a centre, or for the camera at home, has converged [standard
deviations]."""
NUM_HALVINGS = 8
"""Bisections for a quantile, which is then known to 0.5 % of a deviation."""

# Recovery
MIN_TOGETHER = 3
"""Landmarks that must have moved together: two always do, but for their distance."""
VIEW_ANGLE = math.pi
"""Width of the sector in which landmarks are seen [rad]."""
FIX_PATIENCE = 4
"""Failed trials after which one more frame is skipped each time: a trial takes milliseconds."""
KEPT_PER_LANDMARK = 2
"""Sightings kept per landmark: the newest, and one to check it."""
MAX_CANDIDATES, RESECTION_STEPS = 6, 8
"""Poses that are refined, and Gauss-Newton steps for each: a start has the noise of one triple."""
MIN_LOG_ODDS = math.log(1.0 / FALSE_ALARM - 1.0)
"""Log odds of a pose against all alternatives from which it is accepted."""
RESECTION_FRAMES = 30
"""Frames whose residuals are used: some hundred bearings [1]."""

# Smoothing of a whole drive
NUM_WHOLE_SOLVES = 6
"""Solutions of the whole drive, each by several Gauss-Newton steps."""
MAX_WHOLE_SOLVES = 30
"""The same where home turns the map: in halls, three to seven were needed."""
RETAINED_S = 30.0
"""Fixed-lag smoothing of a robot at standstill or without bearings ends this long after its newest
keyframe: then no later bearings correct the pose [s]."""
CONTRADICTED = float(chdtri(3, FALSE_ALARM / 5000))
"""Squared deviation from which poses contradict the motion between them: one false alarm at
`FALSE_ALARM` in 5,000 keyframes, as for `FINAL_GATE` [1]."""

# Home at any pose of a drive
MAX_PREDICTED_SIGMA = 0.5
"""Largest standard deviation of a predicted bearing [rad]; a larger one is not linear, and neither
of use for home nor to identify a landmark."""
NUM_NEAREST = 5
"""Sightings before and after a time by which a landmark was in place then: two wrong ones do not
decide."""

# Landmarks without ids
ASSOCIATION_GATE = 3.5
"""Gate of a bearing around its predicted one: a dozen pairs in a frame are tested [standard
deviations]."""
DISTINGUISHED = (0.008, 0.02)
"""Limits of the noise of bearings to distinguish landmarks: a good camera's, at first, and the
default [rad]."""
ASSOCIATION_MARGIN = 4.0
"""Twice the log likelihood ratio (3 nats) by which a pair must beat its rivals: one in 20 wrong."""
NOT_LIVE = 2.0
"""The same for a landmark in reach that was not seen just before: a fifth of them appear."""
CLEAR_MARGIN = 10.0
"""Pairs with this margin are accepted together: a conditioning hardly changes it."""
MIN_HITS = 3
"""Hits of a track before it counts: a false bearing continues another one by chance."""
REFUTED = -3.0
"""Below this, a track ends: two misses of a landmark that is in view."""
CONFIRMED_AGAIN = 3.5
"""The same for a mapped landmark that was not in view: its bearing is predicted."""
DETECTED = 0.8
"""Probability that a landmark in view is detected: a fifth is hidden or missed."""
CLUTTER_KEPT = 0.02
"""Share of a frame in the mean number of false bearings: 50 frames."""
MIN_CLUTTER = 0.05
"""False bearings in a frame that are always expected, and minimum field of view [rad]."""
FALSE_AT_FIRST = 0.2
"""Assumed at first [1/frame]."""
MAX_FALSE, MIN_SEEN = 0.3, 2.0
"""Largest share of false bearings: a track that ends early may also be of a landmark that is seldom
detected; and bearings in a frame at first."""
TRACK_MEMORY_S = 3.0
"""A track without hits ends: half of the landmarks in view may be missed in each frame [s]."""
LIVE_S = 1.5
"""A landmark that was hit within this time is expected to be seen again [s]."""
TENTATIVE = 5.0
"""Twice the negative log probability that a tentative track is a landmark: a third is."""
MAX_TRACKS = 60
"""Tracks of a local map."""
RECENT_S = 5.0
"""Tracks that were hit within this time may be of a landmark that was seen before [s]."""
DUPLICATE_MARGIN = 6.0
"""As `ASSOCIATION_MARGIN`, for two tracks of one landmark."""
DUPLICATE_SIGMAS = 0.003, 0.01
"""Difference of two tracks of one landmark: bearing [rad] and inverse distance [1/m]."""
MAX_MISSES = 4
"""Successive misses of a track in view: by chance one in 3,000."""
YAW_SCALE_SIGMA, YAW_LAG_S = 0.05, 0.1
"""Error of the scale of yaw rates [1], and their delay, with as large an error [s]."""
UNKNOWN_RATES = 0.1, 0.1, 0.1
"""Growth of variances while the motion is unknown [m^2/s, m^2/s, rad^2/s]."""
TURN_JITTER_S = 0.05
"""Jitter of the stamps, and error of the delay of the odometry while the yaw rate changes; see
`SIGN_LAGS_S` [s]."""
NEAR = 0.25
"""Distance of a near landmark, in median distances [1], ..."""
NEAR_UNKNOWN_M = 0.7
"""... and before anything is mapped [m]."""
MAX_SHARP = 0.1
"""A prediction that is less certain does not keep a new landmark from beginning [rad]."""
SUSPECTED, LOST = 3.0, 10.0
"""Log likelihood ratio of any other pose from which a pose is not verified, and the robot lost."""
LOST_S = 4.0
"""Time for which a lost robot searches before it maps new landmarks [s]."""
SEARCH_S = 0.5
"""Interval of the searches for a lost robot, of which each takes 30 frames, and for tracks of one
landmark [s]."""
REPAIR_S = 2.0
"""Interval of the search for landmarks that were mapped twice [s]."""
TOGETHER = 2
"""Frames in which two landmarks may be seen together although they are one: false bearings."""
UNMATCHED = 0.2
"""Probability that a home bearing belongs to no landmark of the map: moved, or not mapped yet."""
NATS_APART = 7.0
"""Log evidence of home over other places, and of a track against clutter: one in a thousand is
wrong [nats]."""
NATS_KEPT = 2.0
"""Below this, an assignment of home bearings is withdrawn [nats]."""
COPIED = 0.75
"""Probability that a landmark of a place that repeats another one is at its copy's position."""
NUM_CELLS = 30
"""Cells along each side of a map whose area out of view is measured: to 3 %."""
NATS_DIFFERENT = 4.0
"""Log odds against a place that repeats itself, before anything is mapped: one in 50 does, and
each path as long as the reach on which the map is not extended adds one [nats]."""
FIRST_SEARCH_S = 1.0
"""Interval of the searches for home after a landmark was mapped [s], ..."""
SEARCH_GROWTH = 1.3
"""... its growth from search to search [1], ..."""
MAX_SEARCH_S = 30.0
"""... and its maximum [s]."""
MAX_CONSTELLATION = 60
"""Landmarks that a search uses, of those with most sightings: its time grows with them."""
MAX_HYPOTHESES, MIN_TRIPLES, MAX_BEARING_TRIPLES = 400_000, 4, 20
"""Poses from triples with which a search begins, and triples of bearings: several of 20 are of
landmarks only, even if a third of the bearings is of none."""
MAX_SCORED, BEARING_BINS = 2000, 256
"""Poses that are scored exactly: those with most bearings within two bins of a landmark's."""
CONSTELLATION_PAD = 0.35
"""Margin of the region around the landmarks in which the pose may be, by its longer side."""
MAX_STARTS = 500
"""Poses that are refined."""
ANNEALED = (0.05, 0.03, 0.0, 0.0)
"""Tolerances of the refinement [rad]: from the error of a triple to the noise."""
NUM_MATCHES = 60
"""Distinct poses whose evidence is computed."""
REACH, LAST = 0.95, 0.995
"""Quantiles of the distances of sightings that are taken for the reach of the sensor and for the
distance from which hardly anything is seen, ..."""
NUM_DISTANCES = 2000
"""... of the newest ones."""
MIN_MISSES, GHOST = 15, 0.2
"""Frames in which a landmark is not seen where it is predicted, and share of those in which it is
seen, below which it is no landmark: real ones are seen in four of five."""
ANCHOR_S, ANCHORED = 3.0, 0.5
"""Time in which three anchored landmarks must be seen for a verified pose [s], and their share of
all sightings: of a wrong pose, up to a third fit by chance."""
MIN_RETURNS = 2
"""Returns that prove the position of a landmark: one in 20 single ones is of another landmark."""
LINK_FRAMES, LINK_SHARE = 10, 0.25
"""Frames in which a landmark must be seen with an anchored one, or from a proven pose, and share of
its own sightings: by chance it is a tenth."""

"""What the words of reports and documentation mean, in a sentence or two."""

GLOSSARY = {
    "home": "The place that is to be found again: the pose of the robot's centre when home was "
    "stored. It is the origin of the home frame, and the heading there is its x-axis.",
    "bearing": "The direction in which the camera sees a landmark, from the camera's axis, "
    "anti-clockwise [rad]. A bearing says nothing of distance.",
    "home bearing": "The bearing under which a landmark was seen from home. It is wrong since the "
    "landmark was moved.",
    "moved landmark": "One that stands elsewhere than when home was stored, so that its home "
    "bearing is wrong. The probability of that is told with the verdict.",
    "innovation": "A measured bearing minus the one that was predicted before it [rad].",
    "NIS": "Normalised innovation squared: the innovation over its predicted deviation, squared. "
    "It is 1 on average when the predicted deviations are right.",
    "NEES": "Normalised estimation error squared: the error of x, y and heading, weighed by the "
    "inverse of their covariance. It is 3 on average when the covariance is right, larger when the "
    "estimate is surer than it should be. It needs the truth.",
    "resection": "Finding a place from the bearings of known landmarks seen there; three must not "
    "lie on one circle with it.",
    "keyframe": "A moment whose bearings enter the map; there are at most two a second.",
    "gate": "The bound on an innovation beyond which a bearing is not used.",
    "parallax": "By how much the bearing of a landmark changes since the robot moved sideways; "
    "only by it is the distance known.",
    "waiting": "A status: nothing usable yet.",
    "mapping": "A status: landmarks are being mapped; home is not found yet: no pose.",
    "localised": "A status: a pose to rely on, within its covariance.",
    "unverified": "A status: there is a pose, but fewer than four home bearings bear it out, or "
    "another home would fit as well; its covariance covers that.",
    "coasting": "A status: localised before, but there are no bearings now, so that odometry alone "
    "carries the pose on.",
    "start prior": "What is known beforehand of where the robot is when a drive begins. The "
    "paper's filters need one; the localiser does not.",
    "route": "A way through a place that was taught once, by driving it, to be driven again.",
    "way point": "A place on a route where the robot stood when it was taught; there it stands "
    "again as long.",
    "speed scale": "By what factor the odometry's speed is wrong. Bearings cannot tell it: a map "
    "twice as large shows the same bearings.",
}
"""Each term and its meaning."""

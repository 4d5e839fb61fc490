"""Limits of the motion of ground robots, for the detection of implausible odometry."""

MAX_SPEED, MAX_TURN_RATE = 10.0, 20.0
"""Maximum speed [m/s] and yaw rate [rad/s] of the robots that homeward is made for."""
MAX_RATE = 1e4
"""Maximum speed [m/s] or yaw rate [rad/s] of any vehicle; a larger value is a data error."""
MAX_ACCELERATION, MAX_TURN_ACCELERATION = 3.0, 10.0
"""Maximum acceleration [m/s^2, rad/s^2] that robots use; the limit for recordings, where the motion
before and after a sample is known."""
GRIP_ACCELERATION, GRIP_TURN_ACCELERATION = 10.0, 50.0
"""Maximum acceleration that wheels can transmit [m/s^2, rad/s^2]: 1 g for a friction coefficient of
about 1 on a dry floor, with wheels 0.2 m from the centre. The limit for online samples, where only
the motion before is known."""

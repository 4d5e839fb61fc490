"""Limits of the motion of ground robots, by which implausible odometry is detected."""

MAX_SPEED, MAX_TURN_RATE = 10.0, 20.0
"""Maximum speed [m/s] and yaw rate [rad/s] of the robots that homeward is made for."""
MAX_RATE = 1e4
"""A larger speed [m/s] or yaw rate [rad/s] is an error of the data, whatever the vehicle."""
MAX_ACCELERATION, MAX_TURN_ACCELERATION = 3.0, 10.0
"""Maximum acceleration [m/s^2, rad/s^2] that robots use. A recording is tested by it, where the
motion before and after a sample is known."""
GRIP_ACCELERATION, GRIP_TURN_ACCELERATION = 10.0, 50.0
"""Maximum acceleration that wheels can transmit [m/s^2, rad/s^2]: tyres on a dry floor grip with a
friction coefficient of about 1, which gives 1 g; wheels are 0.2 m from the centre. An online sample
is tested by it, since only the motion before it is known."""

/* SPDX-License-Identifier: BSD-3-Clause; copyright: the homeward developers */
/* Pose of a robot relative to home from the bearings of $landmarks landmarks: an extended Kalman filter.
 *
 * Made by homeward $version (homeward export ekf --landmarks $landmarks). No heap and no recursion; the
 * work memory is static, so only one thread may call these functions. Angles [rad] are positive
 * anti-clockwise. */
#ifndef HOMEWARD_EKF_H
#define HOMEWARD_EKF_H

#ifdef __cplusplus
extern "C" {
#endif

#define HOMEWARD_LANDMARKS $landmarks
#define HOMEWARD_STATES (3 + HOMEWARD_LANDMARKS)

typedef $real homeward_real;

typedef struct {
  homeward_real state[HOMEWARD_STATES]; /* R [m], theta, alpha, bearings */
  homeward_real covariance[HOMEWARD_STATES * HOMEWARD_STATES];
  homeward_real active[HOMEWARD_LANDMARKS]; /* 1 where a landmark has been seen */
} homeward_belief;

/* Starts at R [m], theta, alpha with standard deviations; no landmark has been seen. */
void homeward_start(homeward_belief *belief, const homeward_real polar[3],
                    const homeward_real sigma[3]);

/* Predicts over dt [s], at most 0.1 s, with the twist v [m/s], omega [rad/s]. `stored` are the home
 * bearings from the robot's heading at home. Returns 0, or 1 where the result would diverge; then
 * the belief is unchanged. */
int homeward_predict(homeward_belief *belief, const homeward_real stored[HOMEWARD_LANDMARKS],
                     homeward_real v, homeward_real omega, homeward_real dt);

/* Updates with the bearings of one stamp, from the robot's heading; `seen` is 1 for the landmarks
 * in view and 0 for others, whose bearing is any finite number. Returns as homeward_predict. */
int homeward_update(homeward_belief *belief, const homeward_real bearings[HOMEWARD_LANDMARKS],
                    const homeward_real seen[HOMEWARD_LANDMARKS]);

/* Writes x [m], y [m] and heading in the home frame. */
void homeward_pose(const homeward_belief *belief, homeward_real pose[3]);

#ifdef __cplusplus
}
#endif

#endif

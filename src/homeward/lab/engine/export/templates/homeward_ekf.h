/* SPDX-License-Identifier: BSD-3-Clause; copyright: the homeward developers */
/* Pose of a robot relative to home from the bearings of $landmarks landmarks.
 *
 * Made by homeward $version (homeward export ekf --landmarks $landmarks); the model and its
 * derivatives come from homeward's symbolic source. No heap, no recursion, no global state, static
 * sizes; from libm it calls only $functions. Angles [rad] are positive anti-clockwise. */
#ifndef HOMEWARD_EKF_H
#define HOMEWARD_EKF_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define HOMEWARD_LANDMARKS ${landmarks}U
#define HOMEWARD_STATES (3U + HOMEWARD_LANDMARKS)
#define HOMEWARD_TRIANGLE (HOMEWARD_STATES * (HOMEWARD_STATES + 1U) / 2U)

typedef $real homeward_real;

/* Stamps [us] may wrap around, like a hardware timer. Samples must be in order of time, at most 35
 * minutes apart. */
typedef uint32_t homeward_time;

typedef enum {
  HOMEWARD_OK = 0,
  HOMEWARD_LATE,       /* older than the newest sample: not used */
  HOMEWARD_NOT_FINITE, /* not used */
  HOMEWARD_DIVERGED    /* a step was dropped because its result diverged */
} homeward_status;

typedef struct {
  homeward_real start[3];                   /* start prior: R [m], theta, alpha */
  homeward_real start_sigma[3];             /* [m], [rad], [rad] */
  homeward_real stored[HOMEWARD_LANDMARKS]; /* home bearings, from the robot's heading at home */
  homeward_real camera_yaw;                 /* yaw of the camera on the robot */
  homeward_real bearing_sigma;              /* of a sighting without its own */
  homeward_real home_sigma;                 /* of a home bearing; used only by the resection */
  homeward_real speed_sigma;                /* white noise [m/s/sqrt(Hz)] */
  homeward_real turn_sigma;                 /* white noise [rad/s/sqrt(Hz)] */
  homeward_real bearing_walk;               /* white noise of the bearing states [rad/sqrt(s)] */
  homeward_real gate;                       /* largest accepted innovation^2 / variance */
  uint8_t minimum_visible;                  /* a stamp with fewer landmarks in view is not used */
} homeward_settings;

typedef struct {
  uint8_t landmark; /* index of its home bearing; sightings of others are not used */
  homeward_real bearing;
  homeward_real sigma; /* 0: use bearing_sigma of the settings */
} homeward_sighting;

typedef struct {
  homeward_real x; /* [m], in the home frame */
  homeward_real y;
  homeward_real heading;
  homeward_real covariance[6]; /* xx, yx, yy, hx, hy, hh */
} homeward_pose;

typedef struct {
  homeward_real state[HOMEWARD_STATES]; /* R, theta, alpha, bearings */
  homeward_real covariance[HOMEWARD_TRIANGLE]; /* lower triangle, row by row */
  uint32_t active; /* bit i: landmark i has been seen */
} homeward_belief;

typedef struct {
  homeward_time now;
  homeward_time holds; /* remaining time for which the twist is valid */
  homeward_real twist[2];
  bool begun;
} homeward_clock;

typedef struct {
  homeward_settings settings;
  homeward_clock clock;
  homeward_belief belief;
  uint32_t trusted;  /* bit i: landmark i may be used */
  uint32_t accepted; /* bit i: landmark i was used at the last stamp of bearings */
} homeward_ekf;

/* Fills in the settings of the export; the caller sets start, start_sigma and stored. */
void homeward_defaults(homeward_settings *settings);

void homeward_ekf_init(homeward_ekf *ekf, const homeward_settings *settings);

/* Adds a twist, v [m/s] and omega [rad/s], valid from its stamp to the next one, at most 1 s. */
homeward_status homeward_ekf_odometry(homeward_ekf *ekf, homeward_time t, homeward_real v,
                                      homeward_real omega);

/* Adds all sightings of one stamp; where a landmark is repeated, the last one counts. */
homeward_status homeward_ekf_bearings(homeward_ekf *ekf, homeward_time t,
                                      const homeward_sighting *seen, uint8_t count);

/* The pose at the newest sample. */
void homeward_ekf_pose(const homeward_ekf *ekf, homeward_pose *pose);

/* Resection with a consistency check. The EKF assumes that every home bearing is correct; the
 * resection finds those that do not agree with one place of home. It dead-reckons from the start
 * prior, averages the directions to each landmark over short stretches, of which it keeps the
 * newest, triangulates the landmarks, and searches the place of home that agrees with most home
 * bearings. Give it the same samples as the EKF, and call homeward_resection_solve about once a
 * second. */
#define HOMEWARD_STRETCHES ${stretches}U

typedef struct {
  homeward_real direction; /* mean of the sightings, in the frame of dead reckoning */
  homeward_real x;         /* mean place of the robot at these sightings [m] */
  homeward_real y;
  homeward_real weight; /* [1/rad^2]; 0: none */
} homeward_ray;

typedef struct {
  homeward_settings settings;
  homeward_clock clock;
  homeward_real place[3]; /* dead-reckoned x [m], y [m], heading in the home frame */
  homeward_real place_covariance[6];
  homeward_real spacing;   /* length of a stretch [m] */
  homeward_real travelled; /* in the newest stretch [m] */
  homeward_real lasted;    /* duration of all stretches [s] */
  uint32_t stretches;      /* number since dead reckoning was last interrupted */
  homeward_ray rays[HOMEWARD_STRETCHES][HOMEWARD_LANDMARKS];
} homeward_resection;

typedef struct {
  bool decided;        /* at least $agreeing home bearings agree, and most of the located ones */
  uint32_t located;    /* bit i: landmark i has been triangulated */
  uint32_t consistent; /* bit i: located, and its home bearing agrees with the pose */
  homeward_pose pose;  /* of the robot, at the newest sample */
} homeward_answer;

void homeward_resection_init(homeward_resection *resection, const homeward_settings *settings);
homeward_status homeward_resection_odometry(homeward_resection *resection, homeward_time t,
                                            homeward_real v, homeward_real omega);
homeward_status homeward_resection_bearings(homeward_resection *resection, homeward_time t,
                                            const homeward_sighting *seen, uint8_t count);
void homeward_resection_solve(const homeward_resection *resection, homeward_answer *answer);

/* Restarts the EKF from a decided answer of the same stamp, with only the consistent landmarks. An
 * undecided answer changes nothing. */
void homeward_ekf_restart(homeward_ekf *ekf, const homeward_answer *answer);

#ifdef __cplusplus
}
#endif

#endif

/* SPDX-License-Identifier: BSD-3-Clause; copyright: the homeward developers */
/* Where a robot is, relative to home, from the bearings of $landmarks landmarks.
 *
 * Made by homeward $version (homeward export ekf --landmarks $landmarks); the model and its
 * derivatives come from homeward's symbolic source. No heap, no recursion, no global state, static
 * sizes; of libm it calls $functions, and nothing else. Angles [rad] are positive
 * anti-clockwise. */
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

/* Stamps [us] may wrap round, as those of a hardware timer do; samples come in their order, and at
 * least every 35 minutes. */
typedef uint32_t homeward_time;

typedef enum {
  HOMEWARD_OK = 0,
  HOMEWARD_LATE,       /* older than the newest sample: left out */
  HOMEWARD_NOT_FINITE, /* left out */
  HOMEWARD_DIVERGED    /* a step was left out, since its result was no belief */
} homeward_status;

typedef struct {
  homeward_real start[3];                   /* R [m], theta, alpha: where the robot begins */
  homeward_real start_sigma[3];             /* [m], [rad], [rad] */
  homeward_real stored[HOMEWARD_LANDMARKS]; /* home bearings, from the robot's heading at home */
  homeward_real camera_yaw;                 /* of the camera's axis from the robot's heading */
  homeward_real bearing_sigma;              /* of a sighting without one */
  homeward_real home_sigma;                 /* of a home bearing; the resection's alone */
  homeward_real speed_sigma;                /* white noise [m/s/sqrt(Hz)] */
  homeward_real turn_sigma;                 /* white noise [rad/s/sqrt(Hz)] */
  homeward_real bearing_walk;               /* white noise of the bearing states [rad/sqrt(s)] */
  homeward_real gate;                       /* largest innovation^2 / variance accepted */
  uint8_t minimum_visible;                  /* fewer in sight, and a stamp is not used */
} homeward_settings;

typedef struct {
  uint8_t landmark; /* its place among the home bearings; others are left out */
  homeward_real bearing;
  homeward_real sigma; /* 0: that of the settings */
} homeward_sighting;

typedef struct {
  homeward_real x; /* [m], in the home frame */
  homeward_real y;
  homeward_real heading;
  homeward_real covariance[6]; /* of these three: xx, yx, yy, hx, hy, hh */
} homeward_pose;

typedef struct {
  homeward_real state[HOMEWARD_STATES]; /* R, theta, alpha, bearings */
  homeward_real covariance[HOMEWARD_TRIANGLE]; /* its lower triangle, row by row */
  uint32_t active; /* bit i: landmark i has been seen */
} homeward_belief;

typedef struct {
  homeward_time now;
  homeward_time holds; /* how much longer the twist holds */
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

/* The settings of the export; start, start_sigma and stored are the caller's to fill in. */
void homeward_defaults(homeward_settings *settings);

void homeward_ekf_init(homeward_ekf *ekf, const homeward_settings *settings);

/* A twist, v [m/s] and omega [rad/s], that holds from its stamp to the next, at most 1 s. */
homeward_status homeward_ekf_odometry(homeward_ekf *ekf, homeward_time t, homeward_real v,
                                      homeward_real omega);

/* All sightings of one stamp; of equal landmarks the last counts. */
homeward_status homeward_ekf_bearings(homeward_ekf *ekf, homeward_time t,
                                      const homeward_sighting *seen, uint8_t count);

/* The pose at the newest sample. */
void homeward_ekf_pose(const homeward_ekf *ekf, homeward_pose *pose);

/* Resection with a consistency check. The EKF believes every home bearing; this finds those that do
 * not agree with one place of home. It dead-reckons from the start prior, averages the directions to
 * each landmark over short stretches, of which it keeps the newest, triangulates, and looks for the
 * place of home that most home bearings agree with. Feed it what the EKF is fed, and call
 * homeward_resection_solve now and then (once a second is plenty). */
#define HOMEWARD_STRETCHES ${stretches}U

typedef struct {
  homeward_real direction; /* mean of the sightings, in the frame of dead reckoning */
  homeward_real x;         /* and of the places they were seen from [m] */
  homeward_real y;
  homeward_real weight; /* [1/rad^2]; 0: none */
} homeward_ray;

typedef struct {
  homeward_settings settings;
  homeward_clock clock;
  homeward_real place[3]; /* x [m], y [m], heading by dead reckoning, in the home frame */
  homeward_real place_covariance[6];
  homeward_real spacing;   /* length of a stretch [m] */
  homeward_real travelled; /* in the newest stretch [m] */
  homeward_real lasted;    /* all stretches together [s] */
  uint32_t stretches;      /* begun since dead reckoning was last interrupted */
  homeward_ray rays[HOMEWARD_STRETCHES][HOMEWARD_LANDMARKS];
} homeward_resection;

typedef struct {
  bool decided;        /* at least $agreeing home bearings, and most of those located, agree */
  uint32_t located;    /* bit i: landmark i has been triangulated */
  uint32_t consistent; /* bit i: and its home bearing agrees with the pose */
  homeward_pose pose;  /* of the robot, at the newest sample */
} homeward_answer;

void homeward_resection_init(homeward_resection *resection, const homeward_settings *settings);
homeward_status homeward_resection_odometry(homeward_resection *resection, homeward_time t,
                                            homeward_real v, homeward_real omega);
homeward_status homeward_resection_bearings(homeward_resection *resection, homeward_time t,
                                            const homeward_sighting *seen, uint8_t count);
void homeward_resection_solve(const homeward_resection *resection, homeward_answer *answer);

/* Begin again from a decided answer of the same stamp, with the consistent landmarks alone; an
 * undecided one changes nothing. */
void homeward_ekf_restart(homeward_ekf *ekf, const homeward_answer *answer);

#ifdef __cplusplus
}
#endif

#endif

/* SPDX-License-Identifier: BSD-3-Clause; copyright: the homeward developers */
/* See homeward_ekf.h. The blocks between "generated" and "end" come from the symbolic source, split
 * into lines shared by all landmarks and lines of each; the loops around them are written by hand. */
#include "homeward_ekf.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

typedef homeward_real REAL;

#define Q HOMEWARD_LANDMARKS
#define N HOMEWARD_STATES
#define HOLD_US 1000000U        /* validity of a twist */
#define LONGEST_STEP_US 100000U /* a longer interval is predicted in several steps */
#define LOST_VARIANCE ((REAL)$lost_variance) /* density of speed and turn rate without odometry */
#define LARGEST ((REAL)$largest) /* a belief with a larger number in it has diverged */

static void turn(REAL angle, REAL *sine, REAL *cosine) {
  *sine = sin$f(angle);
  *cosine = cos$f(angle);
}

static REAL v_inverse(REAL x) { return (REAL)1 / x; }

static REAL v_ceil(REAL x) { return ceil$f(x); }

static REAL v_atan2(REAL y, REAL x) { return atan2$f(y, x); }

static REAL v_sqrt(REAL x) { return sqrt$f(x); }

static bool is_small(REAL x) { return (x < LARGEST) && (x > -LARGEST); } /* false for NaN */

static REAL wrapped(REAL angle) {
  const REAL two_pi = (REAL)6.28318530717958647693, pi = (REAL)3.14159265358979323846;
  return angle - (two_pi * v_ceil((angle - pi) / two_pi));
}

static bool bit(uint32_t bits, size_t i) { return ((bits >> i) & 1U) != 0U; }

/* Index of row i, column j in a lower triangle. */
static size_t at(size_t i, size_t j) { return ((i * (i + 1U)) / 2U) + j; }

static size_t either(size_t i, size_t j) { return (i > j) ? at(i, j) : at(j, i); }

static bool is_sane(const homeward_belief *belief) {
  bool sane = true;
  for (size_t i = 0; i < N; i++) {
    sane = sane && is_small(belief->state[i]) && (belief->covariance[at(i, i)] >= (REAL)0);
  }
  for (size_t i = 0; i < HOMEWARD_TRIANGLE; i++) {
    sane = sane && is_small(belief->covariance[i]);
  }
  return sane;
}

static bool is_late(const homeward_clock *clock, homeward_time t) {
  return clock->begun && ((t - clock->now) > (UINT32_MAX / 2U));
}

/* The time up to a stamp: steps while the twist is valid, and the rest without odometry. */
typedef struct {
  uint32_t steps;
  REAL dt;
  REAL lost;
} interval;

static interval advanced(homeward_clock *clock, homeward_time t) {
  const homeward_time whole = clock->begun ? (t - clock->now) : 0U;
  const homeward_time held = (whole < clock->holds) ? whole : clock->holds;
  interval found = {(held + LONGEST_STEP_US - 1U) / LONGEST_STEP_US, 0, 0};
  if (found.steps > 0U) found.dt = ((REAL)held * (REAL)1e-6) / (REAL)found.steps;
  found.lost = (REAL)(whole - held) * (REAL)1e-6;
  clock->holds -= held;
  clock->now = t;
  clock->begun = true;
  return found;
}

static void hold(homeward_clock *clock, REAL v, REAL omega) {
  clock->twist[0] = v;
  clock->twist[1] = omega;
  clock->holds = HOLD_US;
}

/* Variance densities of speed and turn rate. */
static void densities(const homeward_settings *settings, REAL density[2]) {
  density[0] = settings->speed_sigma * settings->speed_sigma;
  density[1] = settings->turn_sigma * settings->turn_sigma;
}

/* Sorts the sightings of a stamp by landmark; returns the landmarks seen. */
static uint32_t sorted(const homeward_settings *settings, const homeward_sighting *seen,
                       uint8_t count, REAL y[Q], REAL variance[Q]) {
  uint32_t mask = 0;
  for (size_t i = 0; i < Q; i++) {
    y[i] = 0;
    variance[i] = settings->bearing_sigma * settings->bearing_sigma;
  }
  for (uint8_t k = 0; k < count; k++) {
    const size_t i = seen[k].landmark;
    if ((i < Q) && is_small(seen[k].bearing)) {
      const REAL sigma = seen[k].sigma;
      const REAL counts = ((sigma > 0) && is_small(sigma)) ? sigma : settings->bearing_sigma;
      y[i] = wrapped(seen[k].bearing + settings->camera_yaw);
      variance[i] = counts * counts;
      mask |= (uint32_t)1U << i;
    }
  }
  return mask;
}

static uint32_t ones(uint32_t bits) {
  uint32_t count = 0;
  for (size_t i = 0; i < Q; i++) count += bit(bits, i) ? 1U : 0U;
  return count;
}

/* For each landmark: its row of the transition, by the pose and itself, and by the input. */
typedef struct {
  REAL by_pose[3];
  REAL own;
  REAL by_input[2];
} landmark_row;

#define BETA(i) x[3U + (i)]
#define STORED(i) settings->stored[i]
#define ACTIVE(i) (bit(belief->active, i) ? (REAL)1 : (REAL)0)
#define G(i, c) rows[i].by_pose[c]
#define OWN(i) rows[i].own
#define U(i, c) rows[i].by_input[c]
#define P(i, j) belief->covariance[at(i, j)]

static void propagate(const homeward_settings *settings, homeward_belief *belief,
                      const REAL control[2], REAL dt, landmark_row rows[Q], REAL by_state[9],
                      REAL by_input[6]) {
  REAL *const x = belief->state;
  REAL ahead[3];
  /* generated */
$shared
  for (size_t i = 0; i < Q; i++) {
$own
  }
  /* end */
  (void)memcpy(x, ahead, sizeof ahead);
}

/* P <- G P G' + Gu Qu Gu' + walk dt, in place: rows from the last to the first. */
static void predict(const homeward_settings *settings, homeward_belief *belief,
                    const REAL control[2], const REAL density[2], REAL dt) {
  landmark_row rows[Q];
  REAL by_state[9], by_input[6], half[9];
  const REAL v = density[0] / dt, w = density[1] / dt;
  const REAL walk = settings->bearing_walk * settings->bearing_walk * dt;
  propagate(settings, belief, control, dt, rows, by_state, by_input);
  for (size_t i = Q; i-- > 0U;) {
    const size_t r = 3U + i;
    const REAL in_v = U(i, 0) * v, in_w = U(i, 1) * w;
    REAL by_pose[3]; /* row r of G P */
    for (size_t c = 0; c < 3U; c++) {
      by_pose[c] = (OWN(i) * P(r, c));
      for (size_t k = 0; k < 3U; k++) by_pose[c] += G(i, k) * belief->covariance[either(k, c)];
    }
    for (size_t j = 0; j <= i; j++) {
      const size_t c = 3U + j;
      REAL a = OWN(i) * P(r, c), sum = (in_v * U(j, 0)) + (in_w * U(j, 1));
      for (size_t k = 0; k < 3U; k++) {
        a += G(i, k) * P(c, k);
        sum += by_pose[k] * G(j, k);
      }
      P(r, c) = sum + (a * OWN(j));
    }
    P(r, r) += walk;
    for (size_t c = 0; c < 3U; c++) {
      P(r, c) = (in_v * by_input[c]) + (in_w * by_input[3U + c]);
      for (size_t k = 0; k < 3U; k++) P(r, c) += by_pose[k] * by_state[c + (3U * k)];
    }
  }
  for (size_t i = 0; i < 3U; i++) {
    for (size_t j = 0; j < 3U; j++) {
      half[(3U * i) + j] = 0;
      for (size_t k = 0; k < 3U; k++) {
        half[(3U * i) + j] += by_state[i + (3U * k)] * belief->covariance[either(k, j)];
      }
    }
  }
  for (size_t i = 0; i < 3U; i++) {
    for (size_t j = 0; j <= i; j++) {
      P(i, j) = (by_input[i] * v * by_input[j]) + (by_input[3U + i] * w * by_input[3U + j]);
      for (size_t k = 0; k < 3U; k++) P(i, j) += half[(3U * i) + k] * by_state[j + (3U * k)];
    }
  }
}

/* One step, dropped where the result diverges. */
static homeward_status step(homeward_ekf *ekf, const REAL control[2], const REAL density[2],
                            REAL dt) {
  const homeward_belief before = ekf->belief;
  predict(&ekf->settings, &ekf->belief, control, density, dt);
  if (is_sane(&ekf->belief)) return HOMEWARD_OK;
  ekf->belief = before;
  return HOMEWARD_DIVERGED;
}

/* Predicts the belief to a stamp: with the twist while it is valid, then at rest without odometry,
 * where one step is exact for any time. */
static homeward_status advance(homeward_ekf *ekf, homeward_time t) {
  const interval ahead = advanced(&ekf->clock, t);
  homeward_status status = HOMEWARD_OK, found = HOMEWARD_OK;
  REAL known[2];
  densities(&ekf->settings, known);
  for (uint32_t k = 0; k < ahead.steps; k++) {
    found = step(ekf, ekf->clock.twist, known, ahead.dt);
    status = (found == HOMEWARD_OK) ? status : found;
  }
  if (ahead.lost > 0) {
    const REAL still[2] = {0, 0}, lost[2] = {LOST_VARIANCE, LOST_VARIANCE};
    found = step(ekf, still, lost, ahead.lost);
    status = (found == HOMEWARD_OK) ? status : found;
  }
  return status;
}

/* Innovations and gate use the belief before any update of this stamp; then one landmark after the
 * other. A landmark seen for the first time enters with beta = y and the variance of y. */
static void update(const homeward_settings *settings, homeward_belief *belief, uint32_t seen,
                   const REAL y[Q], const REAL variance[Q], uint32_t *accepted) {
  REAL *const x = belief->state;
  REAL target[Q];
  for (size_t i = 0; i < Q; i++) {
    const size_t r = 3U + i;
    const REAL found = wrapped(y[i] - BETA(i));
    const bool fits = (found * found) <= (settings->gate * (P(r, r) + variance[i]));
    target[i] = BETA(i) + found;
    if (bit(seen & belief->active, i) && fits) *accepted |= (uint32_t)1U << i;
  }
  for (size_t i = 0; i < Q; i++) {
    const size_t r = 3U + i;
    if (bit(seen & ~belief->active, i)) {
      BETA(i) = y[i];
      for (size_t j = 0; j < N; j++) belief->covariance[either(r, j)] = 0;
      P(r, r) = variance[i];
    }
  }
  belief->active |= seen;
  for (size_t i = 0; i < Q; i++) {
    const size_t r = 3U + i;
    if (bit(*accepted, i)) {
      const REAL share = v_inverse(P(r, r) + variance[i]);
      const REAL push = share * (target[i] - BETA(i));
      REAL column[N];
      for (size_t j = 0; j < N; j++) column[j] = belief->covariance[either(r, j)];
      for (size_t j = 0; j < N; j++) {
        const REAL gain = column[j] * share;
        x[j] += column[j] * push;
        for (size_t c = 0; c <= j; c++) P(j, c) -= gain * column[c];
      }
    }
  }
}

void homeward_defaults(homeward_settings *settings) {
  (void)memset(settings, 0, sizeof *settings);
$defaults
}

void homeward_ekf_init(homeward_ekf *ekf, const homeward_settings *settings) {
  homeward_belief *const belief = &ekf->belief;
  (void)memset(ekf, 0, sizeof *ekf);
  ekf->settings = *settings;
  ekf->trusted = UINT32_MAX;
  for (size_t i = 0; i < N; i++) {
    const REAL sigma = (i < 3U) ? settings->start_sigma[i] : (REAL)1;
    if (i < 3U) belief->state[i] = settings->start[i];
    P(i, i) = sigma * sigma;
  }
}

homeward_status homeward_ekf_odometry(homeward_ekf *ekf, homeward_time t, homeward_real v,
                                      homeward_real omega) {
  homeward_status status = HOMEWARD_LATE;
  if (!is_late(&ekf->clock, t)) {
    status = HOMEWARD_NOT_FINITE;
    if (is_small(v) && is_small(omega)) {
      status = advance(ekf, t);
      hold(&ekf->clock, v, omega);
    }
  }
  return status;
}

homeward_status homeward_ekf_bearings(homeward_ekf *ekf, homeward_time t,
                                      const homeward_sighting *seen, uint8_t count) {
  homeward_status status = HOMEWARD_LATE;
  ekf->accepted = 0;
  if (!is_late(&ekf->clock, t)) {
    REAL y[Q], variance[Q];
    uint32_t mask = 0;
    status = advance(ekf, t);
    mask = sorted(&ekf->settings, seen, count, y, variance) & ekf->trusted;
    if (ones(mask) >= ekf->settings.minimum_visible) {
      const homeward_belief before = ekf->belief;
      update(&ekf->settings, &ekf->belief, mask, y, variance, &ekf->accepted);
      if (!is_sane(&ekf->belief)) {
        ekf->belief = before;
        ekf->accepted = 0;
        status = HOMEWARD_DIVERGED;
      }
    }
  }
  return status;
}

void homeward_ekf_pose(const homeward_ekf *ekf, homeward_pose *pose) {
  const homeward_belief *const belief = &ekf->belief;
  const REAL *const x = belief->state;
  /* generated */
$pose
  /* end */
}

/* -- Resection ----------------------------------------------------------------------------------- */

#define STRETCHES HOMEWARD_STRETCHES
#define AGREEING ${agreeing}U                   /* fewer cannot determine and check home */
#define CHANCE ((REAL)${largest_misfit})        /* [rad]: a wrong bearing agrees with probability $chance */
#define GN_MARK 8U  /* Gauss-Newton steps for a landmark, */
#define GN_MINIMAL 3U /* for home from three landmarks, */
#define GN_ALL 4U  /* and from all that agree, in each round of choosing them: */
#define ROUNDS 4U

/* The bearing of a landmark from a pose, and its derivatives. */
static void look(const REAL pose[3], const REAL mark[2], REAL *seen, REAL by_pose[3],
                 REAL by_mark[2]) {
  /* generated */
$look
  /* end */
}

/* The robot's pose in the home frame, for a pose of home in the frame of dead reckoning. */
static void relative(const REAL home[3], const REAL place[3], REAL pose[3], REAL by_home[9]) {
  /* generated */
$relative
  /* end */
}

static void dead_reckon(homeward_resection *resection, const REAL control[2],
                        const REAL density[2], REAL dt) {
  REAL *const x = resection->place;
  REAL *const covariance = resection->place_covariance;
  REAL ahead[3], carried[6];
  /* generated */
$reckon
  /* end */
  (void)memcpy(x, ahead, sizeof ahead);
  (void)memcpy(covariance, carried, sizeof carried);
}

/* The inverse of a symmetric matrix, both lower triangles; false where it has none. */
static bool inverted(const REAL m[6], REAL inverse[6]) {
  REAL determinant;
  bool found;
  inverse[0] = (m[2] * m[5]) - (m[4] * m[4]);
  inverse[1] = (m[4] * m[3]) - (m[1] * m[5]);
  inverse[2] = (m[0] * m[5]) - (m[3] * m[3]);
  inverse[3] = (m[1] * m[4]) - (m[2] * m[3]);
  inverse[4] = (m[1] * m[3]) - (m[0] * m[4]);
  inverse[5] = (m[0] * m[2]) - (m[1] * m[1]);
  determinant = (m[0] * inverse[0]) + (m[1] * inverse[1]) + (m[3] * inverse[3]);
  found = (determinant > 0) && (determinant < (REAL)${largest_determinant});
  for (size_t i = 0; i < 6U; i++) inverse[i] = found ? (inverse[i] / determinant) : 0;
  return found;
}

/* A landmark at the best intersection of its rays, and its covariance. */
typedef struct {
  REAL mark[2];
  REAL covariance[3];
} landmark_place;

/* Solves a x = b of two rows, a symmetric; false where the rays are nearly parallel. */
static bool solved(const REAL a[3], const REAL b[2], REAL x[2]) {
  const REAL determinant = (a[0] * a[2]) - (a[1] * a[1]), trace = a[0] + a[2];
  const bool found = determinant > (trace * trace * (REAL)1e-5);
  if (found) {
    x[0] = ((a[2] * b[0]) - (a[1] * b[1])) / determinant;
    x[1] = ((a[0] * b[1]) - (a[1] * b[0])) / determinant;
  }
  return found;
}

static bool located(const homeward_resection *resection, size_t i, landmark_place *place) {
  REAL a[3] = {0, 0, 0}, b[2] = {0, 0}, ahead[2] = {0, 0}, push[2] = {0, 0};
  REAL *const mark = place->mark;
  bool found;
  for (size_t k = 0; k < STRETCHES; k++) { /* nearest point to all lines, with equal weights */
    const homeward_ray *const ray = &resection->rays[k][i];
    REAL sine, cosine, across;
    turn(ray->direction, &sine, &cosine);
    across = ray->weight * ((cosine * ray->y) - (sine * ray->x));
    a[0] += ray->weight * sine * sine;
    a[1] -= ray->weight * sine * cosine;
    a[2] += ray->weight * cosine * cosine;
    b[0] -= sine * across;
    b[1] += cosine * across;
    ahead[0] += ray->weight * cosine;
    ahead[1] += ray->weight * sine;
  }
  found = solved(a, b, mark);
  b[0] = mark[0] - resection->place[0];
  b[1] = mark[1] - resection->place[1];
  if (found && (((b[0] * ahead[0]) + (b[1] * ahead[1])) < 0)) { /* behind: the rays diverge */
    const REAL far = (REAL)24 * resection->spacing / (a[0] + a[2]);
    mark[0] = resection->place[0] + (far * ahead[0]);
    mark[1] = resection->place[1] + (far * ahead[1]);
  }
  for (uint32_t n = 0; found && (n <= GN_MARK); n++) {
    (void)memset(a, 0, sizeof a);
    (void)memset(b, 0, sizeof b);
    for (size_t k = 0; k < STRETCHES; k++) {
      const homeward_ray *const ray = &resection->rays[k][i];
      const REAL from[3] = {ray->x, ray->y, 0};
      REAL seen, by_pose[3], g[2], residual;
      if (ray->weight > 0) {
        look(from, mark, &seen, by_pose, g);
        residual = ray->weight * wrapped(ray->direction - seen);
        a[0] += ray->weight * g[0] * g[0];
        a[1] += ray->weight * g[0] * g[1];
        a[2] += ray->weight * g[1] * g[1];
        b[0] += g[0] * residual;
        b[1] += g[1] * residual;
      }
    }
    found = solved(a, b, push);
    if (n < GN_MARK) {
      mark[0] += push[0];
      mark[1] += push[1];
    }
    found = found && is_small(mark[0]) && is_small(mark[1]);
  }
  if (found) {
    const REAL determinant = (a[0] * a[2]) - (a[1] * a[1]);
    place->covariance[0] = a[2] / determinant;
    place->covariance[1] = -a[1] / determinant;
    place->covariance[2] = a[0] / determinant;
  }
  return found;
}

/* The evidence for a place of home. */
typedef struct {
  const homeward_resection *resection;
  landmark_place places[Q];
  uint32_t located;
  REAL prior[6];   /* inverse of the covariance of dead reckoning */
  REAL variance;   /* of a home bearing, and of the rotation of dead reckoning in all stretches */
} problem;

/* Difference between a home bearing and the direction of its landmark from home. */
static REAL misfit(const problem *given, size_t i, const REAL home[3], REAL by_home[3],
                   REAL *variance) {
  const landmark_place *const place = &given->places[i];
  REAL seen, g[2];
  look(home, place->mark, &seen, by_home, g);
  *variance = given->variance + (place->covariance[0] * g[0] * g[0]) +
              ((REAL)2 * place->covariance[1] * g[0] * g[1]) +
              (place->covariance[2] * g[1] * g[1]);
  return wrapped(given->resection->settings.stored[i] - seen);
}

/* Difference between the robot's pose and dead reckoning. */
static void astray(const problem *given, const REAL home[3], REAL by_home[9], REAL off[3]) {
  const REAL *const place = given->resection->place;
  relative(home, place, off, by_home);
  for (size_t k = 0; k < 3U; k++) off[k] -= place[k];
  off[2] = wrapped(off[2]);
}

/* The cost of a place of home, and the landmarks that agree with it. */
static REAL judged(const problem *given, const REAL home[3], uint32_t *agree) {
  const REAL gate = (REAL)$resection_gate;
  REAL by_home[9], off[3], score = 0;
  astray(given, home, by_home, off);
  for (size_t i = 0; i < 3U; i++) {
    for (size_t j = 0; j < 3U; j++) score += off[i] * given->prior[either(i, j)] * off[j];
  }
  *agree = 0;
  for (size_t i = 0; i < Q; i++) {
    if (bit(given->located, i)) {
      REAL variance;
      const REAL found = misfit(given, i, home, by_home, &variance);
      const REAL share = (found * found) / variance;
      if (share <= gate) *agree |= (uint32_t)1U << i;
      score += (share <= gate) ? share : gate;
    }
  }
  return score;
}

/* Gauss-Newton for home from some home bearings and dead reckoning; false where it fails. */
static bool refined(const problem *given, uint32_t chosen, uint32_t steps, REAL home[3],
                    REAL covariance[6]) {
  bool found = true;
  for (uint32_t n = 0; found && (n < steps); n++) {
    REAL a[6] = {0, 0, 0, 0, 0, 0}, b[3] = {0, 0, 0}, by_home[9], off[3];
    astray(given, home, by_home, off);
    for (size_t i = 0; i < 3U; i++) {
      for (size_t j = 0; j < 3U; j++) {
        REAL weighed = 0; /* entry (i, j) of the derivative's transpose times the prior */
        for (size_t k = 0; k < 3U; k++) {
          weighed += by_home[k + (3U * i)] * given->prior[either(k, j)];
        }
        b[i] -= weighed * off[j];
        for (size_t k = 0; k <= i; k++) a[at(i, k)] += weighed * by_home[j + (3U * k)];
      }
    }
    for (size_t i = 0; i < Q; i++) {
      if (bit(chosen, i)) {
        REAL variance;
        const REAL residual = misfit(given, i, home, by_home, &variance);
        for (size_t j = 0; j < 3U; j++) {
          b[j] += by_home[j] * residual / variance;
          for (size_t k = 0; k <= j; k++) a[at(j, k)] += by_home[j] * by_home[k] / variance;
        }
      }
    }
    found = inverted(a, covariance);
    for (size_t j = 0; j < 3U; j++) {
      for (size_t k = 0; k < 3U; k++) home[j] += covariance[either(j, k)] * b[k];
    }
    found = found && is_small(home[0]) && is_small(home[1]) && is_small(home[2]);
  }
  return found;
}

/* The best place of home from three landmarks and dead reckoning. */
static void best_of_three(const problem *given, REAL home[3]) {
  uint32_t agree;
  REAL least = judged(given, home, &agree);
  for (size_t i = 0; i < Q; i++) {
    for (size_t j = 0; j < i; j++) {
      for (size_t k = 0; k < j; k++) {
        const uint32_t three = ((uint32_t)1U << i) | ((uint32_t)1U << j) | ((uint32_t)1U << k);
        REAL tried[3] = {0, 0, 0}, covariance[6];
        if (((three & given->located) == three) &&
            refined(given, three, GN_MINIMAL, tried, covariance)) {
          const REAL score = judged(given, tried, &agree);
          if (score < least) {
            least = score;
            (void)memcpy(home, tried, sizeof tried);
          }
        }
      }
    }
  }
}

void homeward_resection_init(homeward_resection *resection, const homeward_settings *settings) {
  const REAL R = settings->start[0], *const sigma = settings->start_sigma;
  REAL sine, cosine, *const covariance = resection->place_covariance;
  const REAL along = sigma[0] * sigma[0], across = R * R * sigma[1] * sigma[1];
  (void)memset(resection, 0, sizeof *resection);
  resection->settings = *settings;
  turn(settings->start[1], &sine, &cosine);
  resection->place[0] = R * cosine;
  resection->place[1] = R * sine;
  resection->place[2] = settings->start[2];
  covariance[0] = (along * cosine * cosine) + (across * sine * sine);
  covariance[1] = (along - across) * sine * cosine;
  covariance[2] = (along * sine * sine) + (across * cosine * cosine);
  covariance[5] = sigma[2] * sigma[2];
  resection->spacing = (R > sigma[0]) ? (R / (REAL)12) : (sigma[0] / (REAL)12);
  resection->travelled = resection->spacing;
}

static void reckon(homeward_resection *resection, homeward_time t) {
  const interval ahead = advanced(&resection->clock, t);
  const REAL v = resection->clock.twist[0], length = (v < 0) ? -v : v;
  REAL known[2];
  densities(&resection->settings, known);
  for (uint32_t k = 0; k < ahead.steps; k++) {
    dead_reckon(resection, resection->clock.twist, known, ahead.dt);
    resection->travelled += length * ahead.dt;
    resection->lasted += ahead.dt;
  }
  if (ahead.lost > 0) { /* older sightings have no known relation to later ones */
    const REAL still[2] = {0, 0}, lost[2] = {LOST_VARIANCE, LOST_VARIANCE};
    dead_reckon(resection, still, lost, ahead.lost);
    (void)memset(resection->rays, 0, sizeof resection->rays);
    resection->lasted = 0;
    resection->stretches = 0;
    resection->travelled = resection->spacing;
  }
}

homeward_status homeward_resection_odometry(homeward_resection *resection, homeward_time t,
                                            homeward_real v, homeward_real omega) {
  homeward_status status = HOMEWARD_LATE;
  if (!is_late(&resection->clock, t)) {
    status = HOMEWARD_NOT_FINITE;
    if (is_small(v) && is_small(omega)) {
      reckon(resection, t);
      hold(&resection->clock, v, omega);
      status = HOMEWARD_OK;
    }
  }
  return status;
}

homeward_status homeward_resection_bearings(homeward_resection *resection, homeward_time t,
                                            const homeward_sighting *seen, uint8_t count) {
  homeward_status status = HOMEWARD_LATE;
  if (!is_late(&resection->clock, t)) {
    REAL y[Q], variance[Q];
    uint32_t mask;
    homeward_ray *rays;
    reckon(resection, t);
    mask = sorted(&resection->settings, seen, count, y, variance);
    if (resection->travelled >= resection->spacing) {
      /* The oldest stretch is dropped from the duration. */
      if (resection->stretches >= STRETCHES) {
        resection->lasted -= resection->lasted / (REAL)STRETCHES;
      }
      resection->travelled = 0;
      resection->stretches++;
      (void)memset(resection->rays[resection->stretches % STRETCHES], 0,
                   sizeof resection->rays[0]);
    }
    rays = resection->rays[resection->stretches % STRETCHES];
    for (size_t i = 0; i < Q; i++) {
      if (bit(mask, i)) {
        homeward_ray *const ray = &rays[i];
        const REAL direction = resection->place[2] + y[i], weight = v_inverse(variance[i]);
        const bool first = !(ray->weight > 0);
        const REAL share = first ? 1 : (weight / (ray->weight + weight));
        if (first) ray->direction = direction;
        ray->direction += share * wrapped(direction - ray->direction);
        ray->x += share * (resection->place[0] - ray->x);
        ray->y += share * (resection->place[1] - ray->y);
        ray->weight += weight;
      }
    }
    status = HOMEWARD_OK;
  }
  return status;
}

void homeward_resection_solve(const homeward_resection *resection, homeward_answer *answer) {
  const homeward_settings *const settings = &resection->settings;
  problem given = {.resection = resection};
  REAL home[3] = {0, 0, 0}, covariance[6], by_home[9], pose[3], half[9];
  uint32_t agree = 0, sure = 0;
  bool found = inverted(resection->place_covariance, given.prior);
  (void)memset(answer, 0, sizeof *answer);
  given.variance = (settings->home_sigma * settings->home_sigma) +
                   (settings->turn_sigma * settings->turn_sigma * resection->lasted);
  for (size_t i = 0; i < Q; i++) {
    if (located(resection, i, &given.places[i])) given.located |= (uint32_t)1U << i;
  }
  if (found) best_of_three(&given, home);
  for (uint32_t n = 0; found && (n < ROUNDS); n++) {
    (void)judged(&given, home, &agree);
    found = refined(&given, agree, GN_ALL, home, covariance);
  }
  if (found) {
    (void)judged(&given, home, &agree);
    for (size_t i = 0; i < Q; i++) {
      REAL variance = 0;
      if (bit(agree, i)) {
        (void)misfit(&given, i, home, by_home, &variance);
        sure += (variance <= (CHANCE * CHANCE)) ? 1U : 0U;
      }
    }
    relative(home, resection->place, pose, by_home);
    for (size_t i = 0; i < 3U; i++) {
      for (size_t j = 0; j < 3U; j++) {
        half[(3U * i) + j] = 0;
        for (size_t k = 0; k < 3U; k++) {
          half[(3U * i) + j] += by_home[i + (3U * k)] * covariance[either(k, j)];
        }
      }
    }
    for (size_t i = 0; i < 3U; i++) {
      for (size_t j = 0; j <= i; j++) {
        for (size_t k = 0; k < 3U; k++) {
          answer->pose.covariance[at(i, j)] += half[(3U * i) + k] * by_home[j + (3U * k)];
        }
      }
    }
    answer->pose.x = pose[0];
    answer->pose.y = pose[1];
    answer->pose.heading = pose[2];
    answer->located = given.located;
    answer->consistent = agree;
    answer->decided = (sure >= AGREEING) && ((2U * ones(agree)) > ones(given.located));
  }
}

void homeward_ekf_restart(homeward_ekf *ekf, const homeward_answer *answer) {
  if (answer->decided) {
    homeward_belief *const belief = &ekf->belief;
    REAL *const x = belief->state;
    const homeward_pose *const pose = &answer->pose;
    (void)memset(belief, 0, sizeof *belief);
    for (size_t i = 3; i < N; i++) P(i, i) = 1;
    ekf->trusted = answer->consistent;
    /* generated */
$restart
    /* end */
  }
}

/* See homeward_ekf.h. The blocks between "generated" and "end" come from the symbolic source, split
 * into what all landmarks share and what each adds; what is around them are loops. */
#include "homeward_ekf.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

typedef homeward_real REAL;

#define Q HOMEWARD_LANDMARKS
#define N HOMEWARD_STATES
#define HOLD_US 1000000U        /* a twist holds so long */
#define LONGEST_STEP_US 100000U /* a longer interval is predicted in several steps */
#define LOST_VARIANCE ((REAL)$lost_variance) /* of speed and turn rate a second, without odometry */
#define LARGEST ((REAL)$largest) /* a belief with a larger number in it has diverged */

static void turn(REAL angle, REAL *sine, REAL *cosine) {
  *sine = sin$f(angle);
  *cosine = cos$f(angle);
}

static REAL v_inverse(REAL x) { return (REAL)1 / x; }

static REAL v_ceil(REAL x) { return ceil$f(x); }

static bool is_small(REAL x) { return (x < LARGEST) && (x > -LARGEST); } /* no NaN is */

static REAL wrapped(REAL angle) {
  const REAL two_pi = (REAL)6.28318530717958647693, pi = (REAL)3.14159265358979323846;
  return angle - (two_pi * v_ceil((angle - pi) / two_pi));
}

static bool bit(uint32_t bits, size_t i) { return ((bits >> i) & 1U) != 0U; }

/* Where row i, column j of a lower triangle stands. */
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

/* Of each landmark: its row of the transition, by the pose and itself, and by the input. */
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

/* One step, or none where the result would be no belief. */
static homeward_status step(homeward_ekf *ekf, const REAL control[2], const REAL density[2],
                            REAL dt) {
  const homeward_belief before = ekf->belief;
  predict(&ekf->settings, &ekf->belief, control, density, dt);
  if (is_sane(&ekf->belief)) return HOMEWARD_OK;
  ekf->belief = before;
  return HOMEWARD_DIVERGED;
}

/* Carry the belief to a stamp: by the twist while it holds, then by its absence, which moves nothing,
 * so that one step does for any time. */
static homeward_status advance(homeward_ekf *ekf, homeward_time t) {
  homeward_status status = HOMEWARD_OK;
  if (ekf->begun) {
    const homeward_time interval = t - ekf->now;
    const homeward_time held = (interval < ekf->holds) ? interval : ekf->holds;
    const uint32_t steps = (held + LONGEST_STEP_US - 1U) / LONGEST_STEP_US;
    const REAL speed = ekf->settings.speed_sigma, turning = ekf->settings.turn_sigma;
    const REAL known[2] = {speed * speed, turning * turning};
    for (uint32_t k = 0; k < steps; k++) {
      const REAL dt = ((REAL)held * (REAL)1e-6) / (REAL)steps;
      const homeward_status found = step(ekf, ekf->twist, known, dt);
      status = (found == HOMEWARD_OK) ? status : found;
    }
    if (interval > held) {
      const REAL still[2] = {0, 0}, lost[2] = {LOST_VARIANCE, LOST_VARIANCE};
      const homeward_status found = step(ekf, still, lost, (REAL)(interval - held) * (REAL)1e-6);
      status = (found == HOMEWARD_OK) ? status : found;
    }
    ekf->holds -= held;
  }
  ekf->begun = true;
  ekf->now = t;
  return status;
}

static bool is_late(const homeward_ekf *ekf, homeward_time t) {
  return ekf->begun && ((t - ekf->now) > (UINT32_MAX / 2U));
}

/* Innovations and gate as of before any update of this stamp, then one landmark after the other. A
 * landmark seen for the first time enters with beta = y and the variance of y. */
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
  for (size_t i = 0; i < N; i++) {
    const REAL sigma = (i < 3U) ? settings->start_sigma[i] : (REAL)1;
    if (i < 3U) belief->state[i] = settings->start[i];
    P(i, i) = sigma * sigma;
  }
}

homeward_status homeward_ekf_odometry(homeward_ekf *ekf, homeward_time t, homeward_real v,
                                      homeward_real omega) {
  homeward_status status = HOMEWARD_LATE;
  if (!is_late(ekf, t)) {
    status = HOMEWARD_NOT_FINITE;
    if (is_small(v) && is_small(omega)) {
      status = advance(ekf, t);
      ekf->twist[0] = v;
      ekf->twist[1] = omega;
      ekf->holds = HOLD_US;
    }
  }
  return status;
}

homeward_status homeward_ekf_bearings(homeward_ekf *ekf, homeward_time t,
                                      const homeward_sighting *seen, uint8_t count) {
  const homeward_settings *const settings = &ekf->settings;
  homeward_status status = HOMEWARD_LATE;
  ekf->accepted = 0;
  if (!is_late(ekf, t)) {
    REAL y[Q], variance[Q];
    uint32_t mask = 0;
    uint32_t in_sight = 0;
    status = advance(ekf, t);
    (void)memset(y, 0, sizeof y);
    (void)memset(variance, 0, sizeof variance);
    for (uint8_t k = 0; k < count; k++) {
      const size_t i = seen[k].landmark;
      if ((i < Q) && is_small(seen[k].bearing)) {
        const REAL sigma = seen[k].sigma;
        const REAL counts = ((sigma > 0) && is_small(sigma)) ? sigma : settings->bearing_sigma;
        y[i] = wrapped(seen[k].bearing + settings->camera_yaw);
        variance[i] = counts * counts;
        in_sight += bit(mask, i) ? 0U : 1U;
        mask |= (uint32_t)1U << i;
      }
    }
    if (in_sight >= settings->minimum_visible) {
      const homeward_belief before = ekf->belief;
      update(settings, &ekf->belief, mask, y, variance, &ekf->accepted);
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
$resection

/* The localiser's innermost loops; see compiled.py. Matrices are row-major, all numbers doubles.
 * Each function does what the Python function that calls it does with NumPy, and stands for it. */

#include <math.h>
#include <string.h>

#define NC 5                     /* calibration */
#define LANDMARK 1
#define BEARING 2
#define SIGMA 3
#define OFFSET 4
#define OFFSET_JACOBIAN 7
#define COLUMNS (7 + 3 * NC)     /* of a sighting */
#define HEAD (3 + NC)            /* pose and calibration */
#define UNKNOWNS (HEAD + 2)      /* a sighting's: those, and the landmark */
#define FREE 0
#define NOISE 3
#define BY_CALIBRATION 12
#define STEP (12 + 3 * NC)       /* columns of a step */

/* Runs side by side: one. It is what a library is asked to prove that it can be loaded. */
int homeward_lanes(void) { return 1; }

static double wrapped(double angle) {
  const double pi = 3.14159265358979323846;
  return angle - 2.0 * pi * ceil((angle - pi) / (2.0 * pi));
}

/* Inverse of a symmetric positive definite 3x3 matrix, by its Cholesky root; 0, or 1 if it is not
 * that. */
static int invert(const double *m, double *inverse) {
  const double a = sqrt(m[0]), b = m[3] / a, d = m[6] / a;
  const double c = sqrt(m[4] - b * b), e = (m[7] - d * b) / c, f = sqrt(m[8] - d * d - e * e);
  const double root[3][3] = {{1.0 / a, 0.0, 0.0},
                             {-b / (a * c), 1.0 / c, 0.0},
                             {(b * e - c * d) / (a * c * f), -e / (c * f), 1.0 / f}};
  for (int i = 0; i < 3; i++)
    for (int q = 0; q < 3; q++)
      inverse[3 * i + q] =
          root[0][i] * root[0][q] + root[1][i] * root[1][q] + root[2][i] * root[2][q];
  return !(a > 0.0 && c > 0.0 && f > 0.0 && isfinite(inverse[0]) && isfinite(inverse[8]));
}

/* Lower Cholesky root in the place of a matrix (m, m); 0, or 1 if it is not positive definite. */
static int root(long m, double *matrix) {
  for (long i = 0; i < m; i++)
    for (long q = 0; q <= i; q++) {
      double sum = matrix[m * i + q];
      for (long k = 0; k < q; k++) sum -= matrix[m * i + k] * matrix[m * q + k];
      if (i == q && !(sum > 0.0)) return 1;
      matrix[m * i + q] = i == q ? sqrt(sum) : sum / matrix[m * q + q];
    }
  return 0;
}

/* Measured minus expected bearing of one sighting, and the Jacobian of the expected one. */
static double residual_of(const double *pose, double c, double s, const double *calibration,
                          const double *position, const double *row, double *jacobian) {
  double arm[3];
  for (int i = 0; i < 3; i++) {
    arm[i] = row[OFFSET + i];
    for (int k = 0; k < NC; k++) arm[i] += row[OFFSET_JACOBIAN + NC * i + k] * calibration[k];
  }
  const double ax = c * arm[0] - s * arm[1], ay = s * arm[0] + c * arm[1];
  const double dx = position[0] - pose[0] - ax, dy = position[1] - pose[1] - ay;
  const double square = fmax(dx * dx + dy * dy, 1e-6), gx = -dy / square, gy = dx / square;
  const double by_offset[3] = {-(gx * c + gy * s), gx * s - gy * c, -1.0};
  jacobian[0] = -gx;
  jacobian[1] = -gy;
  jacobian[2] = gx * ay - gy * ax - 1.0;
  for (int k = 0; k < NC; k++) {
    jacobian[3 + k] = 0.0;
    for (int i = 0; i < 3; i++)
      jacobian[3 + k] += by_offset[i] * row[OFFSET_JACOBIAN + NC * i + k];
  }
  jacobian[3 + NC] = gx;
  jacobian[4 + NC] = gy;
  return wrapped(row[BEARING] - (atan2(dy, dx) - pose[2] - arm[2]));
}

/* Residuals (m) and Jacobians (m, UNKNOWNS) of rows, each with a pose and a position of its own. */
void residuals(long m, const double *poses, const double *calibration, const double *positions,
               const double *rows, double *residual, double *jacobian) {
  for (long i = 0; i < m; i++) {
    const double *pose = poses + 3 * i;
    residual[i] = residual_of(pose, cos(pose[2]), sin(pose[2]), calibration, positions + 2 * i,
                              rows + COLUMNS * i, jacobian + UNKNOWNS * i);
  }
}

/* Add sightings (m, COLUMNS) from w poses, the first of number `first`, of n landmarks; `turns`
 * (w, 2) are cosine and sine of the poses' headings. */
void add_sightings(long w, long n, long m, long first, double trusted, const double *poses,
                   const double *turns, const double *calibration, const double *positions,
                   const double *rows, double *own, double *shared, double *common,
                   double *slope, double *common_slope) {
  const long a = NC + 2 * n;
  for (const double *row = rows; row < rows + m * COLUMNS; row += COLUMNS) {
    const long k = (long)row[0] - first, at = NC + 2 * (long)row[LANDMARK];
    double j[UNKNOWNS];
    double r = residual_of(poses + 3 * k, turns[2 * k], turns[2 * k + 1], calibration,
                           positions + at - NC, row, j);
    const double sigma = row[SIGMA];
    const double scale = 1.0 / (sigma * fmax(fabs(r) / (trusted * sigma), 1.0));
    for (int i = 0; i < UNKNOWNS; i++) j[i] *= scale;
    r *= scale;
    for (int i = 0; i < 3; i++) {
      double *mine = shared + (3 * k + i) * a;
      for (int q = 0; q < 3; q++) own[9 * k + 3 * i + q] += j[i] * j[q];
      for (int q = 0; q < NC; q++) mine[q] += j[i] * j[3 + q];
      mine[at] += j[i] * j[3 + NC];
      mine[at + 1] += j[i] * j[4 + NC];
      slope[3 * k + i] += j[i] * r;
    }
    for (int i = 0; i < NC + 2; i++) {
      const long here = i < NC ? i : at + i - NC;
      for (int q = 0; q < NC; q++) common[here * a + q] += j[3 + i] * j[3 + q];
      common[here * a + at] += j[3 + i] * j[3 + NC];
      common[here * a + at + 1] += j[3 + i] * j[4 + NC];
      common_slope[here] += j[3 + i] * r;
    }
  }
}

/* Add the steps (w - 1, STEP) between w poses. */
void add_odometry(long w, long a, const double *poses, const double *turns,
                  const double *calibration, const double *steps, double *own, double *next,
                  double *shared, double *common, double *slope, double *common_slope) {
  enum { ALL = 6 + NC };
  for (long k = 0; k + 1 < w; k++, steps += STEP) {
    const double c = turns[2 * k], s = turns[2 * k + 1], *p = poses + 3 * k;
    const double dx = p[3] - p[0], dy = p[4] - p[1];
    const double local[3] = {c * dx + s * dy, c * dy - s * dx, p[5] - p[2]};
    double error[3], j[3][ALL] = {{-c, -s, local[1], c, s, 0.0},
                                  {s, -c, -local[0], -s, c, 0.0},
                                  {0.0, 0.0, -1.0, 0.0, 0.0, 1.0}};
    for (int i = 0; i < 3; i++) {
      error[i] = steps[FREE + i] - local[i];
      for (int q = 0; q < NC; q++) {
        const double by = steps[BY_CALIBRATION + NC * i + q];
        error[i] += by * calibration[q];
        j[i][6 + q] = -by;
      }
    }
    double block[ALL][ALL], downhill[ALL], information[9];
    invert(steps + NOISE, information);
    for (int i = 0; i < ALL; i++) {
      double weighted[3];
      for (int q = 0; q < 3; q++) {
        weighted[q] = 0.0;
        for (int l = 0; l < 3; l++) weighted[q] += j[l][i] * information[3 * l + q];
      }
      for (int q = 0; q < ALL; q++)
        block[i][q] = weighted[0] * j[0][q] + weighted[1] * j[1][q] + weighted[2] * j[2][q];
      downhill[i] = weighted[0] * error[0] + weighted[1] * error[1] + weighted[2] * error[2];
    }
    for (int i = 0; i < 3; i++) {
      for (int q = 0; q < 3; q++) {
        own[9 * k + 3 * i + q] += block[i][q];
        own[9 * (k + 1) + 3 * i + q] += block[3 + i][3 + q];
        next[9 * k + 3 * i + q] += block[i][3 + q];
      }
      for (int q = 0; q < NC; q++) {
        shared[(3 * k + i) * a + q] += block[i][6 + q];
        shared[(3 * (k + 1) + i) * a + q] += block[3 + i][6 + q];
      }
      slope[3 * k + i] += downhill[i];
      slope[3 * (k + 1) + i] += downhill[3 + i];
    }
    for (int i = 0; i < NC; i++) {
      for (int q = 0; q < NC; q++) common[i * a + q] += block[6 + i][6 + q];
      common_slope[i] += downhill[6 + i];
    }
  }
}

/* Eliminate all poses but the last; 1 if one is not fixed. */
int eliminate(long w, long a, double *own, const double *next, double *shared, double *slope,
              double *inverse, double *gains) {
  const long wide = a + 4;
  for (long k = 0; k + 1 < w; k++, gains += 3 * wide, inverse += 9) {
    const double *row = shared + 3 * k * a, *n = next + 9 * k;
    if (invert(own + 9 * k, inverse)) return 1;
    for (int i = 0; i < 3; i++) {
      const double *v = inverse + 3 * i;
      double *gain = gains + i * wide;
      for (int q = 0; q < 3; q++) gain[q] = v[0] * n[q] + v[1] * n[3 + q] + v[2] * n[6 + q];
      for (long q = 0; q < a; q++)
        gain[3 + q] = v[0] * row[q] + v[1] * row[a + q] + v[2] * row[2 * a + q];
      gain[3 + a] = v[0] * slope[3 * k] + v[1] * slope[3 * k + 1] + v[2] * slope[3 * k + 2];
    }
    const double *g = gains, *h = g + wide, *l = h + wide;
    for (int i = 0; i < 3; i++) {
      const double x = n[i], y = n[3 + i], z = n[6 + i];
      double *after = shared + (3 * (k + 1) + i) * a;
      for (int q = 0; q < 3; q++) own[9 * (k + 1) + 3 * i + q] -= x * g[q] + y * h[q] + z * l[q];
      for (long q = 0; q < a; q++) after[q] -= x * g[3 + q] + y * h[3 + q] + z * l[3 + q];
      slope[3 * (k + 1) + i] -= x * g[3 + a] + y * h[3 + a] + z * l[3 + a];
    }
  }
  return 0;
}

/* Steps of the poses before the last, newest first; `tail` (3 + a) are those of the last pose and
 * of the shared unknowns. */
void substitute(long w, long a, const double *gains, const double *tail, double *poses) {
  for (long k = w - 2; k >= 0; k--)
    for (int i = 0; i < 3; i++) {
      const double *gain = gains + (3 * k + i) * (a + 4), *after = poses + 3 * (k + 1);
      double step = gain[3 + a];
      for (int q = 0; q < 3; q++) step -= gain[q] * after[q];
      for (long q = 0; q < a; q++) step -= gain[3 + q] * tail[3 + q];
      poses[3 * k + i] = step;
    }
}

/* Move the Gaussian on the newest pose, the calibration and the landmarks (size) on by a motion. */
void move_on(long size, const double *delta, const double *noise, const double *by_calibration,
             const double *calibration, double *mean, double *covariance) {
  const double c = cos(mean[2]), s = sin(mean[2]), turn[3][3] = {{c, -s, 0}, {s, c, 0}, {0, 0, 1}};
  double motion[3], by_head[3][HEAD] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  for (int i = 0; i < 3; i++) {
    motion[i] = delta[i];
    for (int k = 0; k < NC; k++) {
      motion[i] += by_calibration[NC * i + k] * (mean[3 + k] - calibration[k]);
      for (int q = 0; q < 3; q++) by_head[i][3 + k] += turn[i][q] * by_calibration[NC * q + k];
    }
  }
  const double dx = c * motion[0] - s * motion[1], dy = s * motion[0] + c * motion[1];
  by_head[0][2] = -dy;
  by_head[1][2] = dx;
  mean[0] += dx;
  mean[1] += dy;
  mean[2] += motion[2];
  double own[3][3];
  for (int i = 0; i < 3; i++)
    for (int q = 0; q <= i; q++) {
      double sum = 0.0;
      for (int k = 0; k < HEAD; k++)
        for (int l = 0; l < HEAD; l++)
          sum += by_head[i][k] * covariance[k * size + l] * by_head[q][l];
      for (int k = 0; k < 3; k++)
        for (int l = 0; l < 3; l++) sum += turn[i][k] * noise[3 * k + l] * turn[q][l];
      own[i][q] = own[q][i] = sum;
    }
  for (long j = 3; j < size; j++) {
    double moved[3] = {0.0, 0.0, 0.0};
    for (int i = 0; i < 3; i++)
      for (int k = 0; k < HEAD; k++) moved[i] += by_head[i][k] * covariance[j * size + k];
    for (int i = 0; i < 3; i++) covariance[j * size + i] = covariance[i * size + j] = moved[i];
  }
  for (int i = 0; i < 3; i++)
    for (int q = 0; q < 3; q++) covariance[i * size + q] = own[i][q];
}

/* Sightings (m, COLUMNS) from the newest pose against that Gaussian: residuals, Jacobians, their
 * covariance with everything (m, size) and with each other (m, m). */
void predict(long size, long m, const double *mean, const double *covariance, const double *rows,
             double *residual, double *jacobian, double *correlated, double *spread) {
  const double c = cos(mean[2]), s = sin(mean[2]);
  for (long i = 0; i < m; i++) {
    const long at = HEAD + 2 * (long)rows[COLUMNS * i + LANDMARK];
    double *j = jacobian + UNKNOWNS * i, *with = correlated + size * i;
    residual[i] = residual_of(mean, c, s, mean + 3, mean + at, rows + COLUMNS * i, j);
    for (long q = 0; q < size; q++) with[q] = 0.0;
    for (int k = 0; k < UNKNOWNS; k++) {
      const double *p = covariance + (k < HEAD ? k : at + k - HEAD) * size;
      for (long q = 0; q < size; q++) with[q] += j[k] * p[q];
    }
  }
  for (long i = 0; i < m; i++) {
    const long at = HEAD + 2 * (long)rows[COLUMNS * i + LANDMARK];
    const double *j = jacobian + UNKNOWNS * i, sigma = rows[COLUMNS * i + SIGMA];
    for (long q = 0; q < m; q++) {
      const double *with = correlated + size * q;
      double sum = j[HEAD] * with[at] + j[HEAD + 1] * with[at + 1];
      for (int k = 0; k < HEAD; k++) sum += j[k] * with[k];
      spread[m * i + q] = sum + (i == q ? sigma * sigma : 0.0);
    }
  }
}

/* Correct that Gaussian by what `predict` found, which is used up. 1 if `spread` is not positive
 * definite, and the Gaussian is as it was then. */
int correct(long size, long m, double *residual, double *correlated, double *spread,
            double *mean, double *covariance) {
  if (root(m, spread)) return 1;
  for (long i = 0; i < m; i++) { /* the inverse root times `correlated`: independent rows */
    double *mine = correlated + size * i, diagonal = 1.0 / spread[m * i + i];
    for (long k = 0; k < i; k++)
      for (long q = 0; q < size; q++) mine[q] -= spread[m * i + k] * correlated[size * k + q];
    for (long q = 0; q < size; q++) mine[q] *= diagonal;
  }
  for (long i = 0; i < m; i++) {
    const double *mine = correlated + size * i;
    for (long k = 0; k < i; k++) residual[i] -= spread[m * i + k] * residual[k];
    residual[i] /= spread[m * i + i];
    for (long q = 0; q < size; q++) mean[q] += residual[i] * mine[q];
    for (long k = 0; k < size; k++)
      for (long q = 0; q < size; q++) covariance[size * k + q] -= mine[k] * mine[q];
  }
  return 0;
}

/* Covariance of q expected home bearings with what is known (q, size), and of their residuals. */
void spread_home(long q, long size, const double *covariance, const double *by_known,
                 const double *sigmas, double *correlated, double *spread) {
  for (long i = 0; i < q; i++) {
    double *with = correlated + size * i;
    for (long k = 0; k < size; k++) with[k] = 0.0;
    for (long l = 0; l < size; l++) {
      const double by = by_known[size * i + l];
      if (by != 0.0)
        for (long k = 0; k < size; k++) with[k] += by * covariance[size * l + k];
    }
  }
  for (long i = 0; i < q; i++)
    for (long j = 0; j <= i; j++) {
      double sum = i == j ? sigmas[i] * sigmas[i] : 0.0;
      for (long k = 0; k < size; k++) sum += correlated[size * i + k] * by_known[size * j + k];
      spread[q * i + j] = spread[q * j + i] = sum;
    }
}

/* Home where the bearings are linear, for the set `right` (q; 0 or 1). `information` (3, 3) and
 * `slope` (3) come as the prior's and leave as everybody's; out: the inverse of the set's spread,
 * zero outside of it (q, q), the step of home (3) and the log determinant of the set's spread. 1 if
 * the set does not fix home. */
int solve_home(long q, const double *right, const double *spread, const double *by_home,
               const double *residual, double *information, double *slope, double *precision,
               double *step, double *log_volume) {
  /* Outside of the set the matrix is a unit matrix, and its inverse is cleared in the end. */
  double *lower = precision;
  for (long i = 0; i < q; i++)
    for (long j = 0; j < q; j++)
      lower[q * i + j] = right[i] && right[j] ? spread[q * i + j] : i == j;
  if (root(q, lower)) return 1;
  *log_volume = 0.0;
  for (long i = 0; i < q; i++) *log_volume += 2.0 * log(lower[q * i + i]);
  for (long j = 0; j < q; j++) { /* the root's inverse, in its place */
    lower[q * j + j] = 1.0 / lower[q * j + j];
    for (long i = j + 1; i < q; i++) {
      double sum = 0.0;
      for (long k = j; k < i; k++) sum -= lower[q * i + k] * lower[q * k + j];
      lower[q * i + j] = sum / lower[q * i + i];
    }
  }
  for (long i = 0; i < q; i++) /* ... times its transpose: above the diagonal, on it, below it */
    for (long j = i + 1; j < q; j++) {
      double sum = 0.0;
      for (long k = j; k < q; k++) sum += lower[q * k + i] * lower[q * k + j];
      precision[q * i + j] = sum;
    }
  for (long i = 0; i < q; i++) {
    double sum = 0.0;
    for (long k = i; k < q; k++) sum += lower[q * k + i] * lower[q * k + i];
    precision[q * i + i] = right[i] ? sum : 0.0;
  }
  for (long i = 0; i < q; i++)
    for (long j = 0; j < i; j++) precision[q * i + j] = precision[q * j + i];

  for (long i = 0; i < q; i++) {
    double weighted[3] = {0.0, 0.0, 0.0};
    for (long j = 0; j < q; j++)
      for (int k = 0; k < 3; k++) weighted[k] += precision[q * i + j] * by_home[3 * j + k];
    for (int k = 0; k < 3; k++) {
      for (int l = 0; l < 3; l++) information[3 * k + l] += weighted[k] * by_home[3 * i + l];
      slope[k] += weighted[k] * residual[i];
    }
  }
  double inverse[9];
  if (invert(information, inverse)) return 1;
  for (int k = 0; k < 3; k++)
    step[k] = inverse[3 * k] * slope[0] + inverse[3 * k + 1] * slope[1] + inverse[3 * k + 2] * slope[2];
  return 0;
}

/* What twists held for pieces of time say of a motion. `pieces` (n, 4): time without odometry and
 * with it [s], v, omega; `rates` (3, 3): how the variances along, across and of the heading grow,
 * by 1, speed and turn rate. Out: delta (3), covariance (3, 3), jacobian (3, NC), path and sum of
 * turns (2), path by bend (bends). */
void integrate(long n, const double *pieces, const double *calibration, const double *rates,
               double straightest, double lost_speed, double lost_turn, double bend, long bends,
               double *delta, double *covariance, double *jacobian, double *lengths,
               double *by_bend) {
  /* First to the end: what a turn swings is what comes after it. */
  memset(delta, 0, 3 * sizeof(double));
  memset(covariance, 0, 9 * sizeof(double));
  memset(jacobian, 0, 3 * NC * sizeof(double));
  memset(lengths, 0, 2 * sizeof(double));
  memset(by_bend, 0, bends * sizeof(double));
  for (int swings = 0; swings < 2; swings++) {
    double x = 0.0, y = 0.0, psi = 0.0, v = 0.0, rate = 0.0;
    for (const double *p = pieces; p < pieces + 4 * n; p += 4) {
      const double lost = p[0], dt = p[1], speed = fabs(p[2]), turned = fabs(p[3]);
      const double moving = p[2] != 0.0 || p[3] != 0.0;
      const double slip = (p[2] > 0 ? turned : p[2] < 0 ? -turned : 0.0) - p[2] * straightest;
      v = p[2] - calibration[2] * slip;
      rate = moving * ((1.0 + calibration[0]) * p[3] + calibration[1]);
      const double turn = rate * dt;
      const double half = 0.5 * turn + 1e-12, chord = v * dt * (sin(half) / half);
      const double c = cos(psi + 0.5 * turn), s = sin(psi + 0.5 * turn);
      psi += turn;
      if (swings) {
        if (p == pieces) { /* what a lag cuts off at the begin */
          jacobian[3] = v - rate * delta[1];
          jacobian[NC + 3] = rate * delta[0];
          jacobian[2 * NC + 3] = rate;
        }
        const double steady = moving * dt, shift = lost_speed * lost, swing = lost_turn * lost;
        const double by_turn[3] = {y + 0.5 * chord * s - delta[1], delta[0] - x - 0.5 * chord * c,
                                   1.0};
        const double by_path[3] = {c, s, 0.0}, by_slip[3] = {-s, c, 0.0};
        double variance[3];
        for (int i = 0; i < 3; i++)
          variance[i] =
              (rates[3 * i] + rates[3 * i + 1] * speed + rates[3 * i + 2] * turned) * steady +
              (i == 2 ? swing * swing : shift * shift);
        for (int i = 0; i < 3; i++) {
          for (int q = 0; q < 3; q++)
            covariance[3 * i + q] += variance[0] * by_path[i] * by_path[q] +
                                     variance[1] * by_slip[i] * by_slip[q] +
                                     variance[2] * by_turn[i] * by_turn[q];
          jacobian[NC * i] += by_turn[i] * p[3] * dt;
          jacobian[NC * i + 1] += by_turn[i] * steady;
          jacobian[NC * i + 2] -= by_path[i] * slip * dt;
        }
        lengths[0] += speed * dt;
        lengths[1] += fabs(turn);
        const double class = floor(turned / fmax(speed, 1e-6) / bend);
        by_bend[class < bends - 1 ? (long)class : bends - 1] += speed * dt;
      }
      x += chord * c;
      y += chord * s;
    }
    delta[0] = x;
    delta[1] = y;
    delta[2] = psi;
    if (swings) { /* ... and adds at the end */
      jacobian[3] -= v * cos(psi);
      jacobian[NC + 3] -= v * sin(psi);
      jacobian[2 * NC + 3] -= rate;
    }
  }
}

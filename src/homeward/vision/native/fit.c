/* A motion against matches, and fitted to them: as in epipolar.py and refine.py. */

#define UNKNOWNS 5 /* theta, alpha, roll, pitch, rise */
enum {             /* columns of a table of matches, as Pairs names them */
  HOME = 0,
  NOW = 5,
  NOW_TANGENTS = 8,
  SPREAD = 16, /* variance of the azimuth now, covariance, variance of the elevation */
  LARGEST_SIGMA = 19,
  GROWTH,
  COLUMNS
};

/* What a motion says of every match. */
typedef struct {
  double t[3], t_theta[3], t_rise[3];
  double ca, sa, cr, sr, cp, sp;
} Pose;

static Pose pose_of(const double *x) {
  const double c = cos(x[0]), s = sin(x[0]), cr = cos(x[4]), sr = sin(x[4]);
  return (Pose){{c * cr, s * cr, sr},
                {-s * cr, c * cr, 0.0},
                {-c * sr, -s * sr, cr},
                cos(x[1]), sin(x[1]), cos(x[2]), sin(x[2]), cos(x[3]), sin(x[3])};
}

static double inner(const double *a, const double *b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void cross(const double *a, const double *b, double *found) {
  found[0] = a[1] * b[2] - a[2] * b[1];
  found[1] = a[2] * b[0] - a[0] * b[2];
  found[2] = a[0] * b[1] - a[1] * b[0];
}

static void about_z(double c, double s, const double *x, double *found) {
  found[0] = c * x[0] - s * x[1];
  found[1] = s * x[0] + c * x[1];
  found[2] = x[2];
}

/* Whether two rays can show the same thing; `limits` are those of epipolar.py. */
static int possible_of(const Pose *p, const double *x1, const double *y, const double *normal,
                       double growth, double sigma, const double *limits) {
  const double *rays[2] = {y, x1};
  double far[2], doubt = 0.0;
  if (!(inner(x1, y) > limits[1])) return 0;
  for (int i = 0; i < 2; i++) {
    double arm[3];
    cross(p->t, rays[i], arm);
    const double distance = inner(arm, normal), error = limits[0] * sigma * sqrt(inner(arm, arm));
    if (!(distance >= -error)) return 0;
    far[i] = fmax(distance, 1e-12);
    doubt += error / far[i];
  }
  return fabs(log(far[0] / far[1]) - growth) <= limits[2] + doubt;
}

/* Residual of a match in standard deviations, its Jacobian, and whether it is possible. */
static double residual_of(const Pose *p, const double *row, double looseness, const double *limits,
                          double *jacobian, int *possible) {
  const double *x1 = row + HOME, *x2 = row + NOW;
  const double rolled_y = p->cr * x2[1] - p->sr * x2[2], rolled_z = p->sr * x2[1] + p->cr * x2[2];
  const double leaned[3] = {p->cp * x2[0] + p->sp * rolled_z, rolled_y,
                            p->cp * rolled_z - p->sp * x2[0]};
  const double by_roll[3] = {p->sp * rolled_y, -rolled_z, p->cp * rolled_y};
  const double by_pitch[3] = {leaned[2], 0.0, -leaned[0]};
  double y[3], y_roll[3], y_pitch[3], normal[3], lever[3], gradient[3];
  about_z(p->ca, p->sa, leaned, y);
  about_z(p->ca, p->sa, by_roll, y_roll);
  about_z(p->ca, p->sa, by_pitch, y_pitch);
  cross(x1, y, normal);
  cross(p->t, x1, lever);
  about_z(p->ca, -p->sa, lever, gradient);
  const double *spread = row + SPREAD, loose = looseness * looseness;
  const double across = inner(gradient, row + NOW_TANGENTS);
  const double up = inner(gradient, row + NOW_TANGENTS + 3);
  const double variance = (spread[0] + loose) * across * across + 2.0 * spread[1] * across * up +
                          (spread[2] + loose) * up * up;
  const double deviation = sqrt(fmax(variance, 1e-18));
  const double sigma = sqrt(row[LARGEST_SIGMA] * row[LARGEST_SIGMA] + loose);
  jacobian[0] = inner(normal, p->t_theta) / deviation;
  jacobian[1] = (lever[1] * y[0] - lever[0] * y[1]) / deviation;
  jacobian[2] = inner(lever, y_roll) / deviation;
  jacobian[3] = inner(lever, y_pitch) / deviation;
  jacobian[4] = inner(normal, p->t_rise) / deviation;
  *possible = possible_of(p, x1, y, normal, row[GROWTH], sigma, limits);
  return inner(normal, p->t) / deviation;
}

/* Residuals (m, n), Jacobians (m, n, UNKNOWNS) and what is possible, of m motions and n matches in a
 * table (n, columns). 1 if it has other columns. */
int residuals(long m, long n, long columns, const double *motions, const double *table,
              double looseness, const double *limits, double *value, double *jacobian,
              uint8_t *possible) {
  if (columns != COLUMNS) return 1;
  for (long i = 0; i < m; i++) {
    const Pose p = pose_of(motions + UNKNOWNS * i);
    for (long k = i * n; k < (i + 1) * n; k++) {
      int can;
      value[k] = residual_of(&p, table + COLUMNS * (k - i * n), looseness, limits,
                             jacobian + UNKNOWNS * k, &can);
      possible[k] = (uint8_t)can;
    }
  }
  return 0;
}

/* Solve a system with pivots, in the place of the right side; 1 if it has none. */
static int eliminate(double (*a)[UNKNOWNS], double *b) {
  for (int i = 0; i < UNKNOWNS; i++) {
    int best = i;
    for (int q = i + 1; q < UNKNOWNS; q++)
      if (fabs(a[q][i]) > fabs(a[best][i])) best = q;
    if (!(fabs(a[best][i]) > 0.0)) return 1;
    for (int k = 0; k < UNKNOWNS; k++) {
      const double other = a[i][k];
      a[i][k] = a[best][k];
      a[best][k] = other;
    }
    const double other = b[i];
    b[i] = b[best];
    b[best] = other;
    for (int q = i + 1; q < UNKNOWNS; q++) {
      const double times = a[q][i] / a[i][i];
      for (int k = i; k < UNKNOWNS; k++) a[q][k] -= times * a[i][k];
      b[q] -= times * b[i];
    }
  }
  for (int i = UNKNOWNS - 1; i >= 0; i--) {
    for (int k = i + 1; k < UNKNOWNS; k++) b[i] -= a[i][k] * b[k];
    b[i] /= a[i][i];
  }
  return 0;
}

/* Fit m motions (m, UNKNOWNS), each to n matches that count for `counts` (m, n), by as many steps
 * as there are `looseness`. 1 if the table has other columns or a system no solution: motions are of
 * no use then. */
int descend(long m, long n, long columns, long steps, double *motions, const double *table,
            const double *counts, const double *looseness, const double *prior, double scale,
            double longest, const double *limits) {
  if (columns != COLUMNS) return 1;
  for (long i = 0; i < m; i++) {
    double *x = motions + UNKNOWNS * i;
    for (long k = 0; k < steps; k++) {
      const Pose p = pose_of(x);
      double normal[UNKNOWNS][UNKNOWNS] = {{0.0}}, step[UNKNOWNS];
      for (int q = 0; q < UNKNOWNS; q++) step[q] = prior[q] * x[q];
      for (long j = 0; j < n; j++) {
        double jacobian[UNKNOWNS];
        int possible;
        if (counts[i * n + j] == 0.0) continue;
        const double value =
            residual_of(&p, table + COLUMNS * j, looseness[k], limits, jacobian, &possible);
        if (!possible) continue;
        const double near = 1.0 + value * value / (scale * scale);
        const double weight = counts[i * n + j] / (near * near);
        for (int q = 0; q < UNKNOWNS; q++) {
          for (int l = 0; l <= q; l++) normal[q][l] += weight * jacobian[q] * jacobian[l];
          step[q] += weight * jacobian[q] * value;
        }
      }
      for (int q = 0; q < UNKNOWNS; q++) {
        for (int l = 0; l < q; l++) normal[l][q] = normal[q][l];
        normal[q][q] += prior[q] + 1e-9;
      }
      if (eliminate(normal, step)) return 1;
      for (int q = 0; q < UNKNOWNS; q++) x[q] -= clipped(step[q], -longest, longest);
    }
  }
  return 0;
}

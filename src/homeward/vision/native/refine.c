/* A motion against matches, and fitted to them: as in epipolar.py and refine.py. */

#define UNKNOWNS 5 /* theta, alpha, roll, pitch, rise */
#define WIDE 8     /* matches side by side */
enum {             /* columns of a table of matches, as Pairs names them */
  HOME = 0,
  NOW = 5,
  NOW_TANGENTS = 8,
  SPREAD = 16, /* variance of the azimuth now, covariance, variance of the elevation */
  LARGEST_SIGMA = 19,
  GROWTH,
  COLUMNS
};

/* One number of each of several matches. */
typedef double V __attribute__((vector_size(8 * WIDE)));
typedef int64_t Mask __attribute__((vector_size(8 * WIDE)));

/* What a motion says of every match. */
typedef struct {
  double t[3], t_theta[3], t_rise[3];
  double ca, sa, cr, sr, cp, sp;
} Pose;

/* What matches say of a motion: residual in standard deviations, its derivatives, and whether they
 * are possible. */
typedef struct {
  V value, jacobian[UNKNOWNS];
  Mask possible;
} Told;

static Pose pose_of(const double *x) {
  const double c = cos(x[0]), s = sin(x[0]), cr = cos(x[4]), sr = sin(x[4]);
  return (Pose){{c * cr, s * cr, sr},
                {-s * cr, c * cr, 0.0},
                {-c * sr, -s * sr, cr},
                cos(x[1]), sin(x[1]), cos(x[2]), sin(x[2]), cos(x[3]), sin(x[3])};
}

static V either(Mask which, V yes, V no) { return (V)((which & (Mask)yes) | (~which & (Mask)no)); }

static V at_least(V x, double least) { return either(x > least, x, (V){0.0} + least); }

static V root_of_each(V x) {
  for (int l = 0; l < WIDE; l++) x[l] = sqrt(x[l]);
  return x;
}

static V inner(const V *a, const V *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static V along(const V *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static void cross(const V *a, const V *b, V *found) {
  found[0] = a[1] * b[2] - a[2] * b[1];
  found[1] = a[2] * b[0] - a[0] * b[2];
  found[2] = a[0] * b[1] - a[1] * b[0];
}

static void about_z(double c, double s, const V *x, V *found) {
  found[0] = c * x[0] - s * x[1];
  found[1] = s * x[0] + c * x[1];
  found[2] = x[2];
}

/* Whether two rays can show the same thing; `limits` are those of epipolar.py. */
static Mask possible_of(const Pose *p, const V *x1, const V *y, const V *normal, V growth, V sigma,
                        const double *limits) {
  const V t[3] = {(V){0.0} + p->t[0], (V){0.0} + p->t[1], (V){0.0} + p->t[2]};
  const V *rays[2] = {y, x1};
  V far[2], doubt = {0.0};
  Mask good = inner(x1, y) > limits[1];
  for (int i = 0; i < 2; i++) {
    V arm[3];
    cross(t, rays[i], arm);
    const V distance = inner(arm, normal);
    const V error = limits[0] * sigma * root_of_each(inner(arm, arm));
    good &= distance >= -error;
    far[i] = at_least(distance, 1e-12);
    doubt += error / far[i];
  }
  const V ratio = far[0] / far[1], most = limits[2] + doubt;
  for (int l = 0; l < WIDE; l++)
    if (good[l] && !(fabs(log(ratio[l]) - growth[l]) <= most[l])) good[l] = 0;
  return good;
}

/* What some of the matches say, from (COLUMNS, n). */
static Told told_of(const Pose *p, long n, const double *table, double looseness,
                    const double *limits) {
  V row[COLUMNS];
  for (int q = 0; q < COLUMNS; q++) memcpy(row + q, table + q * n, sizeof row[q]);
  const V *x1 = row + HOME, *x2 = row + NOW;
  const V rolled_y = p->cr * x2[1] - p->sr * x2[2], rolled_z = p->sr * x2[1] + p->cr * x2[2];
  const V leaned[3] = {p->cp * x2[0] + p->sp * rolled_z, rolled_y,
                       p->cp * rolled_z - p->sp * x2[0]};
  const V by_roll[3] = {p->sp * rolled_y, -rolled_z, p->cp * rolled_y};
  const V by_pitch[3] = {leaned[2], (V){0.0}, -leaned[0]};
  const V t[3] = {(V){0.0} + p->t[0], (V){0.0} + p->t[1], (V){0.0} + p->t[2]};
  V y[3], y_roll[3], y_pitch[3], normal[3], lever[3], gradient[3];
  about_z(p->ca, p->sa, leaned, y);
  about_z(p->ca, p->sa, by_roll, y_roll);
  about_z(p->ca, p->sa, by_pitch, y_pitch);
  cross(x1, y, normal);
  cross(t, x1, lever);
  about_z(p->ca, -p->sa, lever, gradient);
  const V *spread = row + SPREAD;
  const double loose = looseness * looseness;
  const V across = inner(gradient, row + NOW_TANGENTS);
  const V up = inner(gradient, row + NOW_TANGENTS + 3);
  const V variance = (spread[0] + loose) * across * across + 2.0 * spread[1] * across * up +
                     (spread[2] + loose) * up * up;
  const V by = 1.0 / root_of_each(at_least(variance, 1e-18));
  const V sigma = root_of_each(row[LARGEST_SIGMA] * row[LARGEST_SIGMA] + loose);
  return (Told){
      along(normal, p->t) * by,
      {along(normal, p->t_theta) * by, (lever[1] * y[0] - lever[0] * y[1]) * by,
       inner(lever, y_roll) * by, inner(lever, y_pitch) * by, along(normal, p->t_rise) * by},
      possible_of(p, x1, y, normal, row[GROWTH], sigma, limits),
  };
}

/* Residuals (m, n), Jacobians (UNKNOWNS, m, n) and what is possible, of m motions and n matches in a
 * table (columns, n). 1 if it has other columns or n is no multiple of WIDE. */
EACH_PROCESSOR
int residuals(long m, long n, long columns, const double *motions, const double *table,
              double looseness, const double *limits, double *value, double *jacobian,
              uint8_t *possible) {
  if (columns != COLUMNS || n % WIDE) return 1;
  for (long i = 0; i < m; i++) {
    const Pose p = pose_of(motions + UNKNOWNS * i);
    for (long k = 0; k < n; k += WIDE) {
      const Told told = told_of(&p, n, table + k, looseness, limits);
      memcpy(value + i * n + k, &told.value, sizeof told.value);
      for (int q = 0; q < UNKNOWNS; q++)
        memcpy(jacobian + (q * m + i) * n + k, told.jacobian + q, sizeof told.value);
      for (int l = 0; l < WIDE; l++) possible[i * n + k + l] = told.possible[l] != 0;
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

static double sum_of_each(V x) {
  double sum = 0.0;
  for (int l = 0; l < WIDE; l++) sum += x[l];
  return sum;
}

/* The normal equations of a step: their matrix and right side, without what is known beforehand. */
static void equations(const Pose *p, long n, const double *table, const double *counts,
                      double looseness, double scale, const double *limits,
                      double (*normal)[UNKNOWNS], double *right) {
  V squares[UNKNOWNS][UNKNOWNS] = {{{0.0}}}, sums[UNKNOWNS] = {{0.0}};
  for (long k = 0; k < n; k += WIDE) {
    V counted;
    memcpy(&counted, counts + k, sizeof counted);
    const Told told = told_of(p, n, table + k, looseness, limits);
    const V near = 1.0 + told.value * told.value / (scale * scale);
    const Mask used = told.possible & (counted != 0.0);
    const V weight = either(used, counted / (near * near), (V){0.0});
    for (int q = 0; q < UNKNOWNS; q++) {
      const V weighed = weight * told.jacobian[q];
      for (int l = 0; l <= q; l++) squares[q][l] += weighed * told.jacobian[l];
      sums[q] += weighed * told.value;
    }
  }
  for (int q = 0; q < UNKNOWNS; q++) {
    for (int l = 0; l <= q; l++) normal[q][l] = normal[l][q] = sum_of_each(squares[q][l]);
    right[q] = sum_of_each(sums[q]);
  }
}

/* Fit m motions (m, UNKNOWNS), each to n matches that count for `counts` (m, n), by as many steps
 * as there are `looseness`. 1 if the table has other columns, n is no multiple of WIDE or a system
 * has no solution: motions are of no use then. */
EACH_PROCESSOR
int irls(long m, long n, long columns, long steps, double *motions, const double *table,
            const double *counts, const double *looseness, const double *prior, double scale,
            double longest, const double *limits) {
  if (columns != COLUMNS || n % WIDE) return 1;
  for (long i = 0; i < m; i++) {
    double *x = motions + UNKNOWNS * i;
    for (long k = 0; k < steps; k++) {
      const Pose p = pose_of(x);
      double normal[UNKNOWNS][UNKNOWNS], step[UNKNOWNS];
      equations(&p, n, table, counts + i * n, looseness[k], scale, limits, normal, step);
      for (int q = 0; q < UNKNOWNS; q++) {
        step[q] += prior[q] * x[q];
        normal[q][q] += prior[q] + 1e-9;
      }
      if (eliminate(normal, step)) return 1;
      for (int q = 0; q < UNKNOWNS; q++) x[q] -= clipped(step[q], -longest, longest);
    }
  }
  return 0;
}

/* Home, fitted to a set of home bearings; `right` (q; 0 or 1) marks the set. */

#define KNOWN_YAW 3              /* the camera's, among what is known */
#define PLACES 4                 /* the landmarks', from here on */
#define LONGEST_TURN 1.0         /* of home, at once */

/* What is known when home is to be found; see HomeProblem. */
typedef struct {
  long q, size, same_camera, has_prior;
  double moved_prior, longest_step;
  const double *mean, *covariance, *bearings, *sigmas, *mount, *before, *prior;
} Problem;

/* Covariance of the q expected home bearings with what is known (q, size), and of their residuals,
 * for their Jacobian by their landmarks' places (q, 2). */
void spread_home(const Problem *p, const double *by_place, double *correlated, double *spread) {
  const long q = p->q, size = p->size;
  for (long i = 0; i < q; i++) {
    const double gx = by_place[2 * i], gy = by_place[2 * i + 1];
    const double *x = p->covariance + size * (PLACES + 2 * i), *y = x + size;
    const double *yaw = p->covariance + size * KNOWN_YAW;
    double *with = correlated + size * i;
    for (long k = 0; k < size; k++)
      with[k] = gx * x[k] + gy * y[k] - (p->same_camera ? yaw[k] : 0.0);
  }
  for (long i = 0; i < q; i++)
    for (long j = 0; j <= i; j++) {
      const double *with = correlated + size * i, *place = with + PLACES + 2 * j;
      spread[q * i + j] = spread[q * j + i] =
          (i == j ? p->sigmas[i] * p->sigmas[i] : 0.0) + place[0] * by_place[2 * j] +
          place[1] * by_place[2 * j + 1] - (p->same_camera ? with[KNOWN_YAW] : 0.0);
    }
}

/* Home bearings, linear around a home (3) and what is known (size): residuals with what is known at
 * its mean (q), and Jacobians of the expected ones by the landmarks (q, 2) and by home (q, 3). */
static void linearise(const Problem *p, const double *home, const double *known, double *residual,
                      double *by_place, double *by_home) {
  const double c = cos(home[2]), s = sin(home[2]), *mount = p->mount;
  const double ox = c * mount[0] - s * mount[1], oy = s * mount[0] + c * mount[1];
  for (long i = 0; i < p->q; i++) {
    const double *point = known + PLACES + 2 * i, *mean = p->mean + PLACES + 2 * i;
    const double dx = point[0] - home[0] - ox, dy = point[1] - home[1] - oy;
    const double square = fmax(dx * dx + dy * dy, 1e-4), gx = -dy / square, gy = dx / square;
    const double yaw = mount[2] + (p->same_camera ? known[KNOWN_YAW] : 0.0);
    by_place[2 * i] = gx;
    by_place[2 * i + 1] = gy;
    by_home[3 * i] = -gx;
    by_home[3 * i + 1] = -gy;
    by_home[3 * i + 2] = gx * oy - gy * ox - 1.0;
    residual[i] = wrapped(p->bearings[i] - atan2(dy, dx) + home[2] + yaw);
    residual[i] += gx * (point[0] - mean[0]) + gy * (point[1] - mean[1]);
    if (p->same_camera) residual[i] -= known[KNOWN_YAW] - p->mean[KNOWN_YAW];
  }
}

/* Inverse of the spread (q, q) of a set, zero outside of it, and the log of its determinant. 1 if
 * it is not positive definite. */
static int invert_set(long q, const double *right, const double *spread, double *precision,
                      double *log_volume) {
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
  return 0;
}

/* How far the start prior's home is from another one (3); nowhere without a prior. */
static void off_prior(const Problem *p, const double *home, double *offset) {
  for (int k = 0; k < 3; k++) offset[k] = p->has_prior ? p->prior[k] - home[k] : 0.0;
  offset[2] = wrapped(offset[2]);
}

/* How long a step (3) of home is, the longest that is taken at once being one. */
static double length(const Problem *p, const double *step) {
  const double shift = fmax(fabs(step[0]), fabs(step[1]));
  return fmax(shift / p->longest_step, fabs(step[2]) / LONGEST_TURN);
}

/* Home where the bearings are linear around `at` (3), for a set: the inverse of the set's spread
 * (q, q), the log of its determinant, the information on home (3, 3), and the step to it (3),
 * which is cut short to the longest. 1 if the set does not fix home. */
int solve_home(const Problem *p, const double *at, const double *right, const double *spread,
               const double *by_home, const double *residual, double *information, double *precision,
               double *step, double *log_volume) {
  const long q = p->q;
  double offset[3], slope[3], inverse[9];
  if (invert_set(q, right, spread, precision, log_volume)) return 1;
  off_prior(p, at, offset);
  for (int k = 0; k < 3; k++) {
    const double *by = p->before + 3 * k;
    slope[k] = by[0] * offset[0] + by[1] * offset[1] + by[2] * offset[2];
    for (int l = 0; l < 3; l++) information[3 * k + l] = by[l];
  }
  for (long i = 0; i < q; i++) {
    double weighted[3] = {0.0, 0.0, 0.0};
    for (long j = 0; j < q; j++)
      for (int k = 0; k < 3; k++) weighted[k] += precision[q * i + j] * by_home[3 * j + k];
    for (int k = 0; k < 3; k++) {
      for (int l = 0; l < 3; l++) information[3 * k + l] += weighted[k] * by_home[3 * i + l];
      slope[k] += weighted[k] * residual[i];
    }
  }
  if (invert(information, inverse)) return 1;
  for (int k = 0; k < 3; k++) {
    const double *row = inverse + 3 * k;
    step[k] = row[0] * slope[0] + row[1] * slope[1] + row[2] * slope[2];
    if (!isfinite(step[k])) return 1;
  }
  const double most = length(p, step);
  for (int k = 0; k < 3; k++) step[k] /= fmax(1.0, most);
  return 0;
}

/* What is left of the residuals (q) after the step of home, times their precision. */
static void weigh(long q, const double *precision, const double *by_home, const double *residual,
                  const double *step, double *weighted) {
  for (long i = 0; i < q; i++) weighted[i] = 0.0;
  for (long j = 0; j < q; j++) {
    const double *by = by_home + 3 * j;
    const double left = residual[j] - by[0] * step[0] - by[1] * step[1] - by[2] * step[2];
    for (long i = 0; i < q; i++) weighted[i] += precision[q * j + i] * left;
  }
}

/* What is known (size) after the step of home; `weighted` has room for q. */
static void learn(const Problem *p, const double *correlated, const double *precision,
                  const double *by_home, const double *residual, const double *step,
                  double *weighted, double *known) {
  weigh(p->q, precision, by_home, residual, step, weighted);
  memcpy(known, p->mean, p->size * sizeof(double));
  for (long i = 0; i < p->q; i++)
    for (long k = 0; k < p->size; k++) known[k] += weighted[i] * correlated[p->size * i + k];
}

/* Gauss-Newton from a home (3): at most so many `steps`, until one is no longer than `settled`. `at` is where it begins, and then where the last
 * linearisation is; `known` (size) and `weighted` (q) are room. 1 if the set does not fix home. */
int fit_home(const Problem *p, long steps, double settled, const double *right,
             double *at, double *known, double *weighted, double *residual, double *by_place,
             double *by_home, double *correlated, double *spread, double *information,
             double *precision, double *step, double *log_volume) {
  memcpy(known, p->mean, p->size * sizeof(double));
  for (long n = 0;; n++) {
    linearise(p, at, known, residual, by_place, by_home);
    spread_home(p, by_place, correlated, spread);
    if (solve_home(p, at, right, spread, by_home, residual, information, precision, step, log_volume))
      return 1;
    if (length(p, step) < settled || n == steps - 1) return 0;
    learn(p, correlated, precision, by_home, residual, step, weighted, known);
    for (int k = 0; k < 3; k++) at[k] += step[k];
  }
}

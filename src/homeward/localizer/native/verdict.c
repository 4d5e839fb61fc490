/* What a fit of home says: of each home bearing, of the set, of home's doubt, of the robot. */

static const double LOG_TWO_PI = 1.8378770664093453;

/* Log density of being `off`, of right bearings predicted with a variance; see faults.py. */
static double log_right(double off, double variance, double uniform_from) {
  variance = fmax(variance, 1e-12);
  if (variance > uniform_from * uniform_from) return -LOG_TWO_PI;
  return -0.5 * (off * off / variance + LOG_TWO_PI + log(variance));
}

/* ... and of wrong ones: half pushed by a Gaussian of deviation `scale`, half anywhere. */
static double log_wrong(double off, double variance, double scale, double uniform_from) {
  const double pushed = log_right(off, variance + scale * scale, uniform_from);
  const double more = fmax(pushed, -LOG_TWO_PI), less = fmin(pushed, -LOG_TWO_PI);
  return more + log1p(exp(less - more)) - log(2.0);
}

/* Home bearings (q) minus what everything else predicts, and the variance of that. */
static void innovate(long q, const double *right, const double *spread, const double *precision,
                     const double *by_home, const double *residual, const double *step,
                     const double *home_spread, const double *weighted, double *lever,
                     double *innovation, double *variance) {
  for (long i = 0; i < q; i++)
    for (int k = 0; k < 3; k++) {
      lever[3 * i + k] = 0.0;
      for (long j = 0; j < q; j++) lever[3 * i + k] += precision[q * i + j] * by_home[3 * j + k];
    }
  for (long i = 0; i < q; i++) {
    const double *between = spread + q * i, *by = by_home + 3 * i;
    double l[3], mean = 0.0, own = 0.0, shared = 0.0;
    for (int k = 0; k < 3; k++) l[k] = right[i] ? lever[3 * i + k] : by[k];
    if (!right[i]) {
      mean = residual[i] - by[0] * step[0] - by[1] * step[1] - by[2] * step[2];
      own = between[i];
      for (long j = 0; j < q; j++) {
        mean -= between[j] * weighted[j];
        for (int k = 0; k < 3; k++) l[k] -= between[j] * lever[3 * j + k];
        for (long m = 0; m < q; m++) own -= between[j] * precision[q * j + m] * between[m];
      }
    }
    for (int k = 0; k < 3; k++)
      for (int m = 0; m < 3; m++) shared += l[k] * home_spread[3 * k + m] * l[m];
    const double rest = fmax(precision[q * i + i] - shared, 1e-9);
    innovation[i] = right[i] ? weighted[i] / rest : wrapped(mean);
    variance[i] = right[i] ? 1.0 / rest : own + shared;
  }
}

/* Innovations (q), their variances and the log odds of right against wrong, and the log evidence of
 * the set (1); `scratch` has room for 4 q. 1 if home is not fixed. */
int judge_home(const Problem *p, double scale, double uniform_from, const double *at,
               const double *right, const double *spread, const double *by_home,
               const double *residual, const double *information, const double *precision,
               const double *step, double log_volume, double *scratch, double *innovation,
               double *variance, double *odds, double *evidence) {
  const long q = p->q;
  double home_spread[9], offset[3], square = 0.0, labels = 0.0, wrong = 0.0, n = 0.0;
  const double ratio = log1p(-p->moved_prior) - log(p->moved_prior);
  if (invert(information, home_spread)) return 1;
  weigh(q, precision, by_home, residual, step, scratch);
  innovate(q, right, spread, precision, by_home, residual, step, home_spread, scratch, scratch + q,
           innovation, variance);
  for (long i = 0; i < q; i++) {
    const double against = log_wrong(innovation[i], variance[i], scale, uniform_from);
    odds[i] = ratio + log_right(innovation[i], variance[i], uniform_from) - against;
    labels += right[i] ? log1p(-p->moved_prior) : log(p->moved_prior);
    wrong += right[i] ? 0.0 : against;
    n += right[i];
    for (long j = 0; j < q; j++) square += residual[i] * precision[q * i + j] * residual[j];
  }
  off_prior(p, at, offset);
  for (int k = 0; k < 3; k++)
    for (int l = 0; l < 3; l++) {
      square -= step[k] * information[3 * k + l] * step[l];
      square += offset[k] * p->before[3 * k + l] * offset[l];
    }
  *evidence = -0.5 * (square + log_volume + n * LOG_TWO_PI) + labels + wrong +
              1.5 * LOG_TWO_PI + 0.5 * log_determinant(home_spread);
  return 0;
}

/* Orthonormal basis (2 q, 3) of what moves or turns all landmarks of a set alike, seen from home at
 * `d` (q, 2); zero outside of the set. */
static void rigid_basis(long q, const double *right, const double *d, double *basis) {
  double n = 0.0, x = 0.0, y = 0.0, square = 1e-12;
  for (long i = 0; i < q; i++)
    if (right[i]) n += 1.0, x += d[2 * i], y += d[2 * i + 1];
  x /= fmax(n, 1.0);
  y /= fmax(n, 1.0);
  for (long i = 0; i < q; i++)
    if (right[i]) square += pow(d[2 * i] - x, 2.0) + pow(d[2 * i + 1] - y, 2.0);
  for (long i = 0; i < q; i++) {
    double *b = basis + 6 * i;
    b[1] = b[3] = 0.0;
    b[0] = b[4] = right[i] ? 1.0 / sqrt(n) : 0.0;
    b[2] = right[i] ? -(d[2 * i + 1] - y) / sqrt(square) : 0.0;
    b[5] = right[i] ? (d[2 * i] - x) / sqrt(square) : 0.0;
  }
}

/* Sum over a set, of landmarks corrected to `known` (size) and seen from `at` (3): how their own
 * errors, without what moves or turns all alike, bend their bearings' information (2, 2) on home's
 * place. `scratch` has room for 14 q. */
static void bend_home(const Problem *p, const double *at, const double *right, const double *known,
                      const double *spread, double *scratch, double *chance) {
  const long q = p->q, size = p->size;
  double *d = scratch, *basis = d + 2 * q, *with = basis + 6 * q, inner[3][3] = {{0.0}};
  for (long i = 0; i < 2 * q; i++) d[i] = known[PLACES + i] - at[i % 2];
  rigid_basis(q, right, d, basis);
  memset(with, 0, 6 * q * sizeof(double));
  for (long i = 0; i < 2 * q; i++)
    for (long j = 0; j < 2 * q; j++)
      for (int k = 0; k < 3; k++)
        with[3 * i + k] += p->covariance[size * (PLACES + i) + PLACES + j] * basis[3 * j + k];
  for (long i = 0; i < 2 * q; i++)
    for (int k = 0; k < 3; k++)
      for (int l = 0; l < 3; l++) inner[k][l] += basis[3 * i + k] * with[3 * i + l];
  memset(chance, 0, 4 * sizeof(double));
  for (long i = 0; i < q; i++) {
    if (!right[i]) continue;
    const double x = d[2 * i], y = d[2 * i + 1], square = fmax(x * x + y * y, 1e-4);
    const double a = 2.0 * x * y / (square * square), b = (y * y - x * x) / (square * square);
    const double curvature[2][2] = {{a, b}, {b, -a}};
    double own[2][2];
    for (int u = 0; u < 2; u++)
      for (int v = 0; v < 2; v++) {
        const double *bu = basis + 3 * (2 * i + u), *bv = basis + 3 * (2 * i + v);
        const double *wu = with + 3 * (2 * i + u), *wv = with + 3 * (2 * i + v);
        own[u][v] = p->covariance[size * (PLACES + 2 * i + u) + PLACES + 2 * i + v];
        for (int k = 0; k < 3; k++) {
          own[u][v] -= bu[k] * wv[k] + wu[k] * bv[k];
          for (int l = 0; l < 3; l++) own[u][v] += bu[k] * inner[k][l] * bv[l];
        }
      }
    for (int u = 0; u < 2; u++)
      for (int v = 0; v < 2; v++)
        for (int k = 0; k < 2; k++)
          for (int l = 0; l < 2; l++)
            chance[2 * u + v] +=
                curvature[u][k] * own[k][l] * curvature[l][v] / spread[(q + 1) * i];
  }
}

/* How much of the information (3, 3) on home's place is there by chance (2, 2): `bend`, but of
 * nothing more than a share of `most`. */
static void by_chance(const double *information, const double *bend, double most, double *chance) {
  const double *m = information, at = m[2] / m[8], along = m[5] / m[8];
  const double a = sqrt(m[0] - at * m[2]), b = (m[1] - at * m[5]) / a;
  const double d = sqrt(m[4] - along * m[5] - b * b), root[2][2] = {{a, 0.0}, {b, d}};
  /* In axes in which that information is a unit matrix. */
  const double under[2] = {(bend[2] - b * bend[0] / a) / d, (bend[3] - b * bend[1] / a) / d};
  const double xx = bend[0] / (a * a), xy = under[0] / a, yy = (under[1] - b * xy) / d;
  const double mean = 0.5 * (xx + yy), half = 0.5 * (xx - yy), off = hypot(half, xy);
  const double first = fmin(mean + off, most), second = fmin(mean - off, most);
  const double same = 0.5 * (first + second);
  const double ratio = off > 0.0 ? 0.5 * (first - second) / off : 0.0;
  const double kept[2][2] = {{same + ratio * half, ratio * xy}, {ratio * xy, same - ratio * half}};
  memset(chance, 0, 4 * sizeof(double));
  for (int i = 0; i < 2; i++)
    for (int j = 0; j < 2; j++)
      for (int k = 0; k < 2; k++)
        for (int l = 0; l < 2; l++) chance[2 * i + j] += root[i][k] * kept[k][l] * root[j][l];
}

/* Covariance of home (3, 3) beyond the inverse of the information (3, 3) on it, of which a share of
 * `most` may be there by chance, and `vague` (3, 3) is there always; else see bend_home. 1 if home
 * is not fixed. */
int doubt_home(const Problem *p, double most, const double *at, const double *right,
               const double *known, const double *spread, const double *information,
               const double *vague, double *scratch, double *doubt) {
  double bend[4], chance[4], whole[9], left[9], inverse[9];
  bend_home(p, at, right, known, spread, scratch, bend);
  by_chance(information, bend, most, chance);
  for (int k = 0; k < 9; k++) whole[k] = left[k] = information[k] + vague[k];
  for (int i = 0; i < 2; i++)
    for (int j = 0; j < 2; j++) left[3 * i + j] -= chance[2 * i + j];
  if (invert(left, doubt) || invert(whole, inverse)) return 1;
  for (int k = 0; k < 9; k++) doubt[k] -= inverse[k];
  return 0;
}

/* The newest pose in the home frame (3), its heading not wrapped, and the covariance of that
 * (3, 3), where `home` (3) is `spread_of_home` (3, 3) uncertain; `scratch` has room for 4 q. */
void from_home(long q, long size, const double *mean, const double *covariance,
               const double *correlated, const double *precision, const double *by_home,
               const double *residual, const double *step, const double *home,
               const double *spread_of_home, double *scratch, double *pose, double *spread) {
  double *weighted = scratch, *gain = scratch + q, at[3], by[3][3], own[3][3];
  weigh(q, precision, by_home, residual, step, weighted);
  memset(gain, 0, 3 * q * sizeof(double));
  for (long i = 0; i < q; i++)
    for (int a = 0; a < 3; a++)
      for (long j = 0; j < q; j++)
        gain[q * a + j] += correlated[size * i + a] * precision[q * i + j];
  for (int a = 0; a < 3; a++) {
    at[a] = mean[a];
    for (long i = 0; i < q; i++) at[a] += weighted[i] * correlated[size * i + a];
    for (int b = 0; b < 3; b++) {
      by[a][b] = 0.0;
      own[a][b] = covariance[size * a + b];
      for (long i = 0; i < q; i++) {
        by[a][b] += gain[q * a + i] * by_home[3 * i + b];
        own[a][b] -= gain[q * a + i] * correlated[size * i + b];
      }
    }
  }
  const double c = cos(home[2]), s = sin(home[2]), dx = at[0] - home[0], dy = at[1] - home[1];
  pose[0] = c * dx + s * dy;
  pose[1] = c * dy - s * dx;
  pose[2] = at[2] - home[2];
  const double turn[3][3] = {{c, s, 0}, {-s, c, 0}, {0, 0, 1}};
  double in_all[3][3] = {{-c, -s, pose[1]}, {s, -c, -pose[0]}, {0, 0, -1}};
  for (int a = 0; a < 3; a++) /* home moves the pose with it */
    for (int b = 0; b < 3; b++)
      for (int k = 0; k < 3; k++) in_all[a][b] -= turn[a][k] * by[k][b];
  for (int a = 0; a < 3; a++)
    for (int b = 0; b <= a; b++) {
      double sum = 0.0;
      for (int k = 0; k < 3; k++)
        for (int m = 0; m < 3; m++)
          sum += in_all[a][k] * spread_of_home[3 * k + m] * in_all[b][m] +
                 turn[a][k] * own[k][m] * turn[b][m];
      spread[3 * a + b] = spread[3 * b + a] = sum;
    }
}

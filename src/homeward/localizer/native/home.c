/* Home, where its bearings are linear. */

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
  for (int k = 0; k < 3; k++) {
    const double *row = inverse + 3 * k;
    step[k] = row[0] * slope[0] + row[1] * slope[1] + row[2] * slope[2];
  }
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

/* Home bearings (q) minus what everything else predicts, and the variance of that; `scratch` has
 * room for 4 q. 1 if home is not fixed. */
int innovate(long q, const double *right, const double *spread, const double *precision,
             const double *by_home, const double *residual, const double *information,
             const double *step, double *scratch, double *innovation, double *variance) {
  double inverse[9], *weighted = scratch, *lever = scratch + q;
  if (invert(information, inverse)) return 1;
  weigh(q, precision, by_home, residual, step, weighted);
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
      for (int m = 0; m < 3; m++) shared += l[k] * inverse[3 * k + m] * l[m];
    const double rest = fmax(precision[q * i + i] - shared, 1e-9);
    innovation[i] = right[i] ? weighted[i] / rest : wrapped(mean);
    variance[i] = right[i] ? 1.0 / rest : own + shared;
  }
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

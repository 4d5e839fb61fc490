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

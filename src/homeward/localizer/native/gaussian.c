/* The Gaussian on the newest pose, the calibration and the landmarks. */

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
 * covariance with everything (m, size) and with each other (m, m). 1 if there is no such
 * landmark. */
int predict(long size, long m, const double *mean, const double *covariance, const double *rows,
             double *residual, double *jacobian, double *correlated, double *spread) {
  const double c = cos(mean[2]), s = sin(mean[2]);
  for (long i = 0; i < m; i++) {
    const long at = HEAD + 2 * (long)rows[COLUMNS * i + LANDMARK];
    if (at < HEAD || at >= size) return 1;
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
  return 0;
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

/* Which residuals (m) agree with each other: one after the other, the one is left out that is
 * farthest from what the others let expect, until none is beyond the gate. `spread` (m, m) is used
 * up; `inverse` (m, m) and `told` (m) are scratch. 1 if `spread` is not positive definite. */
int agree(long m, long fewest, double gate, const double *residual, double *spread,
          double *inverse, double *told, unsigned char *kept) {
  if (root(m, spread)) return 1;
  memset(inverse, 0, m * m * sizeof *inverse);
  for (long i = 0; i < m; i++) { /* of the root: lower triangular, too */
    double *mine = inverse + m * i;
    mine[i] = 1.0;
    for (long k = 0; k < i; k++)
      for (long q = 0; q <= k; q++) mine[q] -= spread[m * i + k] * inverse[m * k + q];
    for (long q = 0; q <= i; q++) mine[q] /= spread[m * i + i];
  }
  double *information = spread;
  memset(information, 0, m * m * sizeof *information);
  for (long k = 0; k < m; k++)
    for (long i = 0; i <= k; i++)
      for (long q = 0; q <= k; q++)
        information[m * i + q] += inverse[m * k + i] * inverse[m * k + q];
  for (long i = 0; i < m; i++) {
    kept[i] = 1;
    told[i] = 0.0;
    for (long q = 0; q < m; q++) told[i] += information[m * i + q] * residual[q];
  }
  for (long left = m; left >= fewest; left--) {
    long worst = -1;
    double farthest = gate * gate;
    for (long i = 0; i < m; i++) {
      const double square = kept[i] ? told[i] * told[i] / information[m * i + i] : 0.0;
      if (square > farthest) farthest = square, worst = i;
    }
    if (worst < 0) break;
    kept[worst] = 0;
    const double *row = information + m * worst;
    const double own = row[worst], share = told[worst] / own;
    for (long i = 0; i < m; i++) told[i] -= share * row[i];
    for (long i = 0; i < m; i++) {
      if (!kept[i]) continue;
      const double by = row[i] / own;
      for (long q = 0; q < m; q++) information[m * i + q] -= by * row[q];
    }
  }
  return 0;
}

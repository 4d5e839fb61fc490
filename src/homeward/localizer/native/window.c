/* The window: what sightings and odometry say, and the poses eliminated. */

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
 * (w, 2) are cosine and sine of the poses' headings. 1 if there is no such pose or landmark. */
int add_sightings(long w, long n, long m, long first, double trusted, const double *poses,
                   const double *turns, const double *calibration, const double *positions,
                   const double *rows, double *own, double *shared, double *common,
                   double *slope, double *common_slope) {
  const long a = NC + 2 * n;
  for (const double *row = rows; row < rows + m * COLUMNS; row += COLUMNS) {
    const long k = (long)row[0] - first, at = NC + 2 * (long)row[LANDMARK];
    if (k < 0 || k >= w || at < NC || at >= a) return 1;
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
  return 0;
}

/* Add the steps (w - 1, STEP) between w poses, those far off at less weight. */
void add_odometry(long w, long a, double trusted, const double *poses, const double *turns,
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
    double square = 0.0;
    for (int i = 0; i < 3; i++)
      for (int q = 0; q < 3; q++) square += error[i] * information[3 * i + q] * error[q];
    const double excess = square / (trusted * trusted);
    if (excess > 1.0)
      for (int i = 0; i < 9; i++) information[i] /= excess;
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

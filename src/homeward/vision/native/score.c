/* Many motions scored by all matches, as in two_point.py. */

#define HALVES 4 /* components of a motion */

/* Add to each sum (m) the square of a row's product with a motion, (HALVES, m).
 * Not inlined: compilers then still know that arrays do not overlap, and take several at once. */
__attribute__((noinline)) static void add_squares(long m, const float *row,
                                                  const float *restrict motions,
                                                  float *restrict sums) {
  const float a = row[0], b = row[1], c = row[2], d = row[3];
  for (long i = 0; i < m; i++) {
    const float product = a * motions[i] + b * motions[m + i] + c * motions[2 * m + i] +
                          d * motions[3 * m + i];
    sums[i] += product * product;
  }
}

/* Add to each cost (m) a square over its variance, `most` at most. */
__attribute__((noinline)) static void add_costs(long m, const float *restrict square,
                                                const float *restrict variance, float most,
                                                float *restrict costs) {
  for (long i = 0; i < m; i++) {
    const float cost = square[i] / variance[i];
    costs[i] += cost < most ? cost : most;
  }
}

/* Costs (m) of motions (HALVES, m) by n matches, each with rows (count, HALVES): its equation, and
 * how it changes with errors. `scratch` is room for 2 m numbers. */
void score(long m, long n, long count, const float *motions, const float *rows, double most,
           float *scratch, float *costs) {
  float *square = scratch, *variance = scratch + m;
  for (long i = 0; i < m; i++) costs[i] = 0.0f;
  for (long j = 0; j < n; j++, rows += HALVES * count) {
    for (long i = 0; i < m; i++) {
      square[i] = 0.0f;
      variance[i] = 1e-16f;
    }
    add_squares(m, rows, motions, square);
    for (long q = 1; q < count; q++) add_squares(m, rows + HALVES * q, motions, variance);
    add_costs(m, square, variance, (float)most, costs);
  }
}

/* The renderer's innermost loop; it does what raycast.py does with NumPy. */

#include <stdint.h>

/* Number of parallel runs: one. Called to test that the library can be loaded. */
int homeward_lanes(void) { return 1; }

#define TILES 6   /* limits of a rectangle: shift, minimum and maximum tile coordinates */
#define PART 1024 /* rays that stay in the first cache */

/* Keep n hits on a rectangle that are nearer than earlier hits.
 * Not inlined: compilers then still assume that arrays do not overlap, and vectorise. */
__attribute__((noinline)) static void meet(long n, const float *restrict x, const float *restrict y,
                                           const float *restrict z, const float *m,
                                           const float *limits, float tiny, int16_t index,
                                           float *restrict distance, float *restrict across,
                                           float *restrict along, int16_t *restrict surface) {
  const float a = m[0], b = m[1], c = m[2], d = m[3], e = m[4], f = m[5], g = m[6], h = m[7];
  const float i = m[8], shift_s = limits[0], shift_t = limits[1];
  const float s0 = limits[2], t0 = limits[3], s1 = limits[4], t1 = limits[5];
  for (long j = 0; j < n; j++) {
    const float q0 = a * x[j] + b * y[j] + c * z[j], far = 1.0f / (q0 > tiny ? q0 : tiny);
    const float s = (d * x[j] + e * y[j] + f * z[j]) * far + shift_s;
    const float t = (g * x[j] + h * y[j] + i * z[j]) * far + shift_t;
    const int inside = (s >= s0) & (t >= t0) & (s <= s1) & (t <= t1);
    const int met = (q0 > 0.0f) & (far < distance[j]) & inside;
    distance[j] = met ? far : distance[j];
    across[j] = met ? s : across[j];
    along[j] = met ? t : along[j];
    surface[j] = met ? index : surface[j];
  }
}

/* Intersect n rays, (3, n), with m rectangles, each with its matrix, (m, 3, 3). */
void cast(long n, long m, const int64_t *indices, const float *rays, const float *matrices,
          const float *limits, double tiny, float *distance, float *across, float *along,
          int16_t *surface) {
  for (long at = 0; at < n; at += PART) {
    const long count = n - at < PART ? n - at : PART;
    const float *x = rays + at;
    for (long k = 0; k < m; k++)
      meet(count, x, x + n, x + 2 * n, matrices + 9 * k, limits + TILES * k, (float)tiny,
           (int16_t)indices[k], distance + at, across + at, along + at, surface + at);
  }
}

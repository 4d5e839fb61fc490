/* Philox4x32-10, a counter-based generator (Salmon and others, "Parallel random numbers: as easy
 * as 1, 2, 3", 2011): numbers depend only on seed, run, step and place, never on lanes, blocks or
 * threads. homeward.lab.engine.batch.execution is the same in NumPy. */

INLINE void philox(WU c[4], uint64_t seed) {
  uint64_t k0 = seed & 0xffffffff, k1 = seed >> 32;
  const WU low = (WU){0} + 0xffffffff;
  for (int round = 0; round < 10; round++) {
    WU a = c[0] * 0xD2511F53, b = c[2] * 0xCD9E8D57;
    c[0] = (b >> 32) ^ c[1] ^ k0;
    c[1] = b & low;
    c[2] = (a >> 32) ^ c[3] ^ k1;
    c[3] = a & low;
    k0 = (k0 + 0x9E3779B9) & 0xffffffff;
    k1 = (k1 + 0xBB67AE85) & 0xffffffff;
  }
}

/* 52 random bits as a number in [0, 1). */
INLINE W uniform(WU high, WU low) {
  return (W)((((high << 32) | low) >> 12) | 0x3ff0000000000000) - 1.0;
}

/* Two numbers in [0, 1) for each lane's run. */
INLINE void uniforms(uint64_t seed, WU run, int64_t step, int64_t place, W out[2]) {
  WU c[4] = {(WU){0} + (uint64_t)place, (WU){0} + (uint64_t)step, run & 0xffffffff, run >> 32};
  philox(c, seed);
  out[0] = uniform(c[0], c[1]);
  out[1] = uniform(c[2], c[3]);
}

/* Two standard normal numbers (Box and Muller). */
INLINE void normals(uint64_t seed, WU run, int64_t step, int64_t place, W out[2]) {
  W u[2], sine, cosine;
  uniforms(seed, run, step, place, u);
  W radius = w_sqrt(-2.0 * w_log(1.0 - u[0]));
  w_sincos(6.28318530717958647693 * u[1], &sine, &cosine);
  out[0] = radius * cosine;
  out[1] = radius * sine;
}

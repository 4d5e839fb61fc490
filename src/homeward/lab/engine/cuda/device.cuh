/* Functions for generated code: REAL arithmetic, and the generator of native/noise.h, one number at
 * a time. Doubles draw the CPU's numbers; floats use the leading 32 of their 52 bits. */
#define v_set(x) ((REAL)(x))
#define v_lt(a, b) ((REAL)((a) < (b)))
#define v_le(a, b) ((REAL)((a) <= (b)))
#define v_eq(a, b) ((REAL)((a) == (b)))
#define v_ne(a, b) ((REAL)((a) != (b)))
#define v_if(c, x) ((c) != (REAL)0 ? (x) : (REAL)0)
#define INLINE static __device__ __forceinline__
#define TWO_PI 6.28318530717958647693

#ifdef SINGLE
#define v_abs fabsf
#define v_ceil ceilf
#define v_floor floorf
#define v_min fminf
#define v_max fmaxf
#define v_sqrt sqrtf
INLINE REAL v_inverse(REAL x) { return __fdividef(1.0f, x); }

/* Angles are reduced to near zero, where alone the fast functions are accurate. */
INLINE void turn(REAL x, REAL *sine, REAL *cosine) {
  const REAL turns = rintf(x * (REAL)(1.0 / TWO_PI));
  x = fmaf(-turns, 6.28125f, x);
  __sincosf(fmaf(-turns, (REAL)(TWO_PI - 6.28125), x), sine, cosine);
}
#else
#define v_abs fabs
#define v_ceil ceil
#define v_floor floor
#define v_min fmin
#define v_max fmax
#define v_sqrt sqrt
INLINE REAL v_inverse(REAL x) { return 1.0 / x; }

/* The kernels of fdlibm after a reduction by Cody and Waite, as in native/lanes.h. Coefficients in
 * constant memory are operands; literals would be moved into a register at every use. */
static __constant__ double of_turn[] = {
    0.63661977236758134308,     1.57079632673412561417e+00, 6.07710050630396597660e-11,
    2.02226624879595063154e-21, 1.58969099521155010221e-10, -2.50507602534068634195e-08,
    2.75573137070700676789e-06, -1.98412698298579493134e-04, 8.33333333332248946124e-03,
    -1.66666666666666324348e-01, -1.13596475577881948265e-11, 2.08757232129817482790e-09,
    -2.75573143513906633035e-07, 2.48015872894767294178e-05, -1.38888888888741095749e-03,
    4.16666666666666019037e-02,
};
INLINE void turn(REAL x, REAL *sine, REAL *cosine) {
  if (!(fabs(x) < 1e6)) {
    sincos(x, sine, cosine);
    return;
  }
  const double *const k = of_turn;
  const REAL turns = rint(x * k[0]);
  const int quadrant = (int)turns;
  const REAL r = fma(-turns, k[3], fma(-turns, k[2], fma(-turns, k[1], x))), z = r * r;
  REAL s = fma(z, fma(z, fma(z, fma(z, fma(z, k[4], k[5]), k[6]), k[7]), k[8]), k[9]);
  REAL c = fma(z, fma(z, fma(z, fma(z, fma(z, k[10], k[11]), k[12]), k[13]), k[14]), k[15]);
  s = fma(r * z, s, r);
  c = fma(z * z, c, fma(-0.5, z, 1.0));
  const REAL a = quadrant & 1 ? c : s, b = quadrant & 1 ? s : c;
  *sine = quadrant & 2 ? -a : a;
  *cosine = (quadrant + 1) & 2 ? -b : b;
}
#endif

/* atan of a ratio in [0, 1] by a minimax polynomial (error 1e-8) or, in doubles, the rational
 * function of Cephes; the octant is corrected afterwards, without a branch. */
#ifndef SINGLE
static __constant__ double of_atan[] = {
    -8.750608600031904122785e-1, -1.615753718733365076637e1, -7.500855792314704667340e1,
    -1.228866684490136173410e2,  -6.485021904942025371773e1, 2.485846490142306297962e1,
    1.650270098316988542046e2,   4.328810604912902668951e2,  4.853903996359136964868e2,
    1.945506571482613964425e2,
};
#endif
INLINE REAL v_atan2(REAL y, REAL x) {
  const REAL ax = v_abs(x), ay = v_abs(y), big = v_max(ax, ay), small = v_min(ax, ay);
#ifdef SINGLE
  const REAL t = big > 0 ? __fdividef(small, big) : 0.0f, z = t * t;
  REAL a = fmaf(z, 0.00290355437f, -0.0162830153f);
  a = fmaf(z, a, 0.0430393795f);
  a = fmaf(z, a, -0.0753367703f);
  a = fmaf(z, a, 0.106546778f);
  a = fmaf(z, a, -0.142071338f);
  a = fmaf(z, a, 0.199930541f);
  a = fmaf(z, a, -0.33333094f);
  a = fmaf(t * z, a, t);
#else
  const bool wide = small > 0.41421356237309504880 * big;
  const REAL above = wide ? small - big : small, below = wide ? small + big : big;
  const REAL t = below > 0 ? above / below : 0.0, z = t * t;
  const double *const k = of_atan;
  const REAL p = z * fma(z, fma(z, fma(z, fma(z, k[0], k[1]), k[2]), k[3]), k[4]);
  const REAL q = fma(z, fma(z, fma(z, fma(z, z + k[5], k[6]), k[7]), k[8]), k[9]);
  REAL a = fma(t, p / q, t);
  a = wide ? a + TWO_PI / 8 : a;
#endif
  a = ay > ax ? (REAL)(TWO_PI / 4) - a : a;
  a = x < 0 ? (REAL)(TWO_PI / 2) - a : a;
  return copysign(a, y);
}

struct Words {
  unsigned a, b, c, d;
};

/* `keys`: keys of each round, computed from the seed in advance. */
INLINE Words philox(const unsigned *keys, long long run, long long step, unsigned place) {
  Words w = {place, (unsigned)step, (unsigned)run, (unsigned)((unsigned long long)run >> 32)};
#pragma unroll
  for (int round = 0; round < 10; round++) {
    const unsigned left = __umulhi(w.a, 0xD2511F53u), low = w.a * 0xD2511F53u;
    const unsigned right = __umulhi(w.c, 0xCD9E8D57u), bottom = w.c * 0xCD9E8D57u;
    w = {right ^ w.b ^ keys[2 * round], bottom, left ^ w.d ^ keys[2 * round + 1], low};
  }
  return w;
}

/* A number in [0, 1) from 52 of 64 bits. */
INLINE REAL uniform(unsigned high, unsigned low) {
#ifdef SINGLE
  return (REAL)(high >> 8) * 5.9604644775390625e-8f;
#else
  return (double)((((unsigned long long)high << 32) | low) >> 12) * 2.220446049250313e-16;
#endif
}

INLINE void uniforms(const Words w, REAL out[2]) {
  out[0] = uniform(w.a, w.b);
  out[1] = uniform(w.c, w.d);
}

/* Two standard normal numbers (Box and Muller). */
INLINE void normals(const Words w, REAL out[2]) {
  REAL sine, cosine;
#ifdef SINGLE
  const REAL left = ((REAL)~w.a + 0.5f) * 2.3283064365386963e-10f;
  const REAL radius = sqrtf(-1.3862943611198906f * __log2f(left));
  __sincosf((REAL)(int)w.c * (REAL)(TWO_PI / 4294967296.0), &sine, &cosine);
#else
  const REAL radius = sqrt(-2.0 * log(1.0 - uniform(w.a, w.b)));
  turn(TWO_PI * uniform(w.c, w.d), &sine, &cosine);
#endif
  out[0] = radius * cosine;
  out[1] = radius * sine;
}

/* Vectors of doubles as wide as the machine's registers, and the functions that steps need on them.
 * V is the number type of a program: a whole vector with one run per lane, or one double.
 *
 * sin, cos and log use the kernels of fdlibm, atan2 the rational function of Cephes; the error of
 * each is about one unit in the last place. */
#ifdef SINGLE
/* Packing straight-line code of doubles into vectors costs gcc more moves than it saves. */
#pragma GCC optimize("no-tree-slp-vectorize")
#endif
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#ifndef WIDTH
#if defined(__AVX512F__) && defined(__AVX512DQ__)
#define WIDTH 8
#elif defined(__AVX__)
#define WIDTH 4
#else
#define WIDTH 2 /* NEON, SSE2, or emulated by the compiler */
#endif
#endif

typedef double W __attribute__((vector_size(8 * WIDTH)));
typedef int64_t WI __attribute__((vector_size(8 * WIDTH)));
typedef uint64_t WU __attribute__((vector_size(8 * WIDTH)));

#define INLINE static inline __attribute__((always_inline, unused))

INLINE W w_set(double x) { return (W){0} + x; }
INLINE W w_select(WI mask, W yes, W no) { return (W)((mask & (WI)yes) | (~mask & (WI)no)); }
INLINE W w_flag(WI mask) { return (W)(mask & (WI)w_set(1.0)); }
INLINE W w_abs(W x) { return (W)((WI)x & INT64_MAX); }
INLINE W w_sign_of(W sign, W x) { return (W)(((WI)sign & INT64_MIN) | ((WI)x & INT64_MAX)); }

INLINE int w_any(WI mask) {
  int64_t any = 0;
  for (int l = 0; l < WIDTH; l++) any |= mask[l];
  return any != 0;
}

INLINE W w_sqrt(W x) {
  W y;
  for (int l = 0; l < WIDTH; l++) y[l] = __builtin_sqrt(x[l]);
  return y;
}

/* Adding and taking away 1.5 * 2^52 rounds to the nearest integer. */
#define ROUNDER 6755399441055744.0

INLINE W w_ceil(W x) {
  W rounded = (x + ROUNDER) - ROUNDER;
  W up = rounded + w_flag(rounded < x);
  return w_select(w_abs(x) < 2251799813685248.0, up, x);
}
INLINE W w_floor(W x) { return -w_ceil(-x); }

/* For angles near zero; see w_is_far. */
INLINE void w_sincos(W x, W *sine, W *cosine) {
  W shifted = x * 0.63661977236758134308 + ROUNDER;
  W turns = shifted - ROUNDER;
  WI quadrant = (WI)shifted;
  /* pi/2 in three parts (Cody and Waite): exact products up to 2^20 turns */
  W r = x - turns * 1.57079632673412561417e+00;
  r = r - turns * 6.07710050630396597660e-11;
  r = r - turns * 2.02226624879595063154e-21;
  W z = r * r;
  W s = r + r * z * (-1.66666666666666324348e-01 + z * (8.33333333332248946124e-03 +
        z * (-1.98412698298579493134e-04 + z * (2.75573137070700676789e-06 +
        z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)))));
  W c = 1.0 - 0.5 * z + z * z * (4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03 +
        z * (2.48015872894767294178e-05 + z * (-2.75573143513906633035e-07 +
        z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11)))));
  WI swap = -(quadrant & 1);
  W a = w_select(swap, c, s), b = w_select(swap, s, c);
  *sine = (W)((WI)a ^ ((quadrant & 2) << 62));
  *cosine = (W)((WI)b ^ (((quadrant + 1) & 2) << 62));
}
INLINE WI w_is_far(W x) { return ~(w_abs(x) < 1e6); } /* NaN too */

INLINE W w_atan2(W y, W x) {
  W ax = w_abs(x), ay = w_abs(y);
  WI steep = ay > ax;
  W big = w_select(steep, ay, ax), small = w_select(steep, ax, ay);
  WI wide = small > 0.41421356237309504880 * big;
  W above = w_select(wide, small - big, small), below = w_select(wide, small + big, big);
  W t = above / w_select(below == 0.0, w_set(1.0), below), z = t * t;
  W p = z * ((((-8.750608600031904122785e-1 * z - 1.615753718733365076637e1) * z -
              7.500855792314704667340e1) * z - 1.228866684490136173410e2) * z -
             6.485021904942025371773e1);
  W q = ((((z + 2.485846490142306297962e1) * z + 1.650270098316988542046e2) * z +
          4.328810604912902668951e2) * z + 4.853903996359136964868e2) * z +
        1.945506571482613964425e2;
  W a = t * (p / q) + t;
  a = w_select(wide, a + 7.85398163397448309616e-1, a);
  a = w_select(steep, 1.57079632679489661923 - a, a);
  a = w_select((WI)x < 0, 3.14159265358979323846 - a, a); /* the sign bit: -0 too */
  return w_sign_of(y, a);
}

/* For normal, positive numbers. */
INLINE W w_log(W x) {
  WI bits = (WI)x + (0x3ff0000000000000 - 0x3fe6a09e667f3bcd);
  W e = (W)(((WU)bits >> 52) | 0x4330000000000000) - (4503599627370496.0 + 1023.0);
  W m = (W)((bits & 0x000fffffffffffff) + 0x3fe6a09e667f3bcd);
  W f = m - 1.0, s = f / (2.0 + f), z = s * s;
  W r = z * (6.666666666666735130e-01 + z * (3.999999999940941908e-01 +
        z * (2.857142874366239149e-01 + z * (2.222219843214978396e-01 +
        z * (1.818357216161805012e-01 + z * (1.531383769920937332e-01 +
        z * 1.479819860511658591e-01))))));
  W h = 0.5 * f * f;
  return e * 6.93147180369123816490e-01 -
         ((h - (s * (h + r) + e * 1.90821492927058770002e-10)) - f);
}

#ifdef SINGLE

#define LANES 1
#define AT_ONCE WIDTH
typedef double V;
#define v_set(x) (x)
#define v_at(v, l) (v)
#define v_put(v, l, x) ((v) = (x))
#define v_lt(a, b) ((double)((a) < (b)))
#define v_le(a, b) ((double)((a) <= (b)))
#define v_eq(a, b) ((double)((a) == (b)))
#define v_ne(a, b) ((double)((a) != (b)))
#define v_if(c, x) ((c) != 0.0 ? (x) : 0.0)
#define v_abs fabs
#define v_sqrt sqrt
#define v_ceil ceil
#define v_floor floor
#define v_min fmin
#define v_max fmax
#define v_atan2 atan2

#else

#define LANES WIDTH
#define AT_ONCE 1
typedef W V;
#define v_set w_set
#define v_at(v, l) ((v)[l])
#define v_put(v, l, x) ((v)[l] = (x))
#define v_lt(a, b) w_flag((a) < (b))
#define v_le(a, b) w_flag((a) <= (b))
#define v_eq(a, b) w_flag((a) == (b))
#define v_ne(a, b) w_flag((a) != (b))
#define v_if(c, x) ((W)(((c) != 0.0) & (WI)(x)))
#define v_abs w_abs
#define v_sqrt w_sqrt
#define v_ceil w_ceil
#define v_floor w_floor
#define v_min(a, b) w_select((a) < (b), a, b)
#define v_max(a, b) w_select((a) > (b), a, b)
#define v_atan2 w_atan2

#endif

#define v_inverse(x) (1.0 / (x))

/* Sines and cosines of several angles: vector by vector, or doubles packed into vectors. Angles far
 * from zero go through the C library, lane by lane, so that no lane depends on another. Arrays of
 * doubles are as long as whole vectors. */
#define PADDED(count) (((count) + AT_ONCE - 1) / AT_ONCE * AT_ONCE)

static __attribute__((noinline, unused)) void sincos_all(int count, const V *angle, V *sine,
                                                         V *cosine) {
  WI far = {0};
#ifdef SINGLE
  for (int k = 0; k < count; k += WIDTH) {
    W a, s, c;
    memcpy(&a, angle + k, sizeof a);
    w_sincos(a, &s, &c);
    far |= w_is_far(a);
    memcpy(sine + k, &s, sizeof s);
    memcpy(cosine + k, &c, sizeof c);
  }
#else
  for (int k = 0; k < count; k++) {
    w_sincos(angle[k], sine + k, cosine + k);
    far |= w_is_far(angle[k]);
  }
#endif
  if (__builtin_expect(!w_any(far), 1)) return;
  const double *a = (const double *)angle;
  double *s = (double *)sine, *c = (double *)cosine;
  for (int i = 0; i < count * LANES; i++)
    if (!(fabs(a[i]) < 1e6)) s[i] = sin(a[i]), c[i] = cos(a[i]);
}

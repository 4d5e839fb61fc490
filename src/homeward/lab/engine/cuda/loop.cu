/* Many runs of a filter, in closed loop or over recorded inputs. GROUP threads compute a run; when
 * it ends they fetch the next. The covariance is stored as a lower triangle in the order pose,
 * estimated home bearings, bearings: then a row of the transition ends at its diagonal, and rows are
 * predicted in place from the last to the first. */
#define PACK(i, j) ((i) * ((i) + 1) / 2 + (j))
#define PACKED PACK(N, 0)
#define HEAD (3 + R)
#define S(k) pool[(k) * STRIDE]
#define X(k) S(AT_X + (k) - 3)
#define T(i, k) S(AT_T + (i) * TEMP + (k))
#define BETA(i) X(HEAD + (i))
#define OUTER(k) ((k) < 3 ? (k) : (k) < HEAD ? (k) + Q : (k) - R)
#define INNER(k) ((k) < 3 ? (k) : (k) < 3 + Q ? (k) + R : (k) - Q)
/* For each landmark: its row of G by the pose and by itself, of Gu, its sighting and innovation. */
#define G(i, c) T(i, c)
#define OWN(i) T(i, 3)
#define U(i, c) T(i, 4 + (c))
#define Y(i) T(i, 6)
#define STORED(i) READ_STORED(i)
#define ACTIVE(i) ((REAL)BIT(active, i))
#define BY_STORED(i) T(i, 7)
#define INNOVATION(i) T(i, 0)
#define TARGET(i) T(i, 1)

#if GROUP == 1
#define LANE 0
#define SYNC()
#define P(i, j) triangle[PACK(i, j)]
#define ROWS _Pragma("unroll")
#else
#define LANE lane
#define SYNC() __syncwarp(group)
#define P(i, j) S(AT_P + PACK(i, j))
#define ROWS _Pragma("unroll 1")
#endif
#define EACH(i, count) for (int i = LANE; i < (count); i += GROUP)
#define SYMMETRIC(i, j) P((i) > (j) ? (i) : (j), (i) > (j) ? (j) : (i))

#if Q > 32
typedef unsigned long long Bits;
#else
typedef unsigned Bits;
#endif
#define BIT(bits, i) ((unsigned)((bits) >> (i)) & 1u)

/* Index of a landmark's estimated home bearing; -1: none. */
__device__ constexpr int parameter_of[Q] = PARAMETERS;

#if GROUP > 1
INLINE Bits joined(Bits bits, unsigned group) {
  Bits all = __reduce_or_sync(group, (unsigned)bits);
#if Q > 32
  all |= (Bits)__reduce_or_sync(group, (unsigned)(bits >> 32)) << 32;
#endif
  return all;
}

INLINE REAL sum_of(REAL x, unsigned group) {
#pragma unroll
  for (int far = GROUP / 2; far > 0; far /= 2) x += __shfl_xor_sync(group, x, far);
  return x;
}
#define all_lanes(x) sum_of(x, group)
#else
#define all_lanes(x) (x)
#endif

extern "C" __global__ void __launch_bounds__(BLOCK, BLOCKS) homeward_batch(
    const __grid_constant__ Job job) {
  POOL_MEMORY
#if GROUP == 1
  REAL *const pool = memory + threadIdx.x;
  REAL triangle[PACKED];
#else
  const int lane = threadIdx.x % GROUP;
  const unsigned group = (GROUP == 32 ? ~0u : (1u << GROUP % 32) - 1) << threadIdx.x % 32 / GROUP * GROUP;
  REAL *const pool = memory + threadIdx.x / GROUP * SLOTS;
#endif
  REAL x[3] = {0, 0, 0}, pose[3] = {0, 0, 0}, control[2] = {0, 0};
  REAL total = 0;
  Bits active = 0;
  double sums[SUMS] = {0};
  long long run = 0, until = 0, k = 0;
  bool begins = true, lost = false, doubtful = false;
  for (;;) {
    if (begins) {
      if (!lost) {
#if GROUP == 1
        run = atomicAdd((unsigned long long *)job.next, 1ull);
#else
        unsigned long long next = 0;
        if (lane == 0) next = atomicAdd((unsigned long long *)job.next, 1ull);
        run = __shfl_sync(group, next, 0, GROUP);
#endif
        if (run >= job.runs) break;
        if (job.selected) run = job.only[run];
        until = job.steps;
        doubtful = false;
      }
      begins = false;
      k = 0;
      active = 0;
#pragma unroll
      for (int i = 0; i < 3; i++) {
        x[i] = READ_STATE(i);
        pose[i] = READ_POSE(i);
      }
      control[0] = control[1] = 0;
      for (int i = 0; i < SUMS; i++) sums[i] = 0;
      EACH(i, R + Q) X(3 + i) = READ_STATE(OUTER(3 + i));
      EACH(i, Q * TEMP) S(AT_T + i) = 0;
      for (int i = 0; i < Q; i++) active |= (Bits)(READ_ACTIVE(i) != (REAL)0) << i;
#ifdef AT_LANDMARKS
      EACH(i, 2 * Q) S(AT_LANDMARKS + i) = START_LANDMARKS(i);
#endif
#ifdef AT_STORED
      EACH(i, Q) S(AT_STORED + i) = START_STORED(i);
#endif
#ifdef AT_INTEGRAL
      EACH(i, N) S(AT_INTEGRAL + i) = READ_INTEGRAL(i);
#endif
      ROWS for (int i = 0; i < N; i++) {
        ROWS for (int j = LANE; j <= i; j += GROUP) P(i, j) = READ_COVARIANCE(OUTER(i) + N * OUTER(j));
      }
      SYNC();
    } else {
#include "advance"
      k++;
    }
#include "total"
    if (!(total < MAX_BELIEF)) {
      /* Repeats the run up to the sample before, whose results are kept. */
      lost = k > 0 && !lost;
      begins = true;
      until = k - 1;
      if (!lost && LANE == 0) {
        job.samples[run] = 0;
        job.diverged[run] = 1;
        job.doubtful[run] = 1;
      }
      SYNC();
      continue;
    }
#include "observe"
    if (STOP || k == until) {
      if (LANE == 0) {
        job.samples[run] = k + 1;
        job.stopped[run] = STOP && !lost;
        job.diverged[run] = lost;
        job.doubtful[run] = doubtful || lost;
      }
#include "finish"
      lost = false;
      begins = true;
    }
    SYNC();
  }
}

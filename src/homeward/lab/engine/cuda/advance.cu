/* One sample: draw, move, measure; predict; update. */
      const long long number = job.first + run;
      Bits seen = 0;
#include "shared"
      for (int i = LANE; i < Q; i += GROUP) {
#include "own"
      }
#ifdef WORLD
      pose[0] = moved[0], pose[1] = moved[1], pose[2] = moved[2];
#endif
#if GROUP > 1
      seen = joined(seen, group);
      SYNC();
#endif
#ifdef AT_INTEGRAL
      /* Pi kappa */
#pragma unroll
      for (int i = 0; i < 3; i++)
        for (int c = 0; c < N; c++) ahead[i] += READ_PROPORTIONAL(i + c * N) * S(AT_INTEGRAL + c);
      EACH(i, R + Q) {
        REAL push = 0;
        for (int c = 0; c < N; c++) push += READ_PROPORTIONAL(OUTER(3 + i) + c * N) * S(AT_INTEGRAL + c);
        X(3 + i) += push;
      }
      SYNC();
#endif
      x[0] = ahead[0], x[1] = ahead[1], x[2] = ahead[2];

      /* P <- G P G' + Gu Q Gu' + diag(state_variance), rows from the last to the first */
      const REAL q00 = READ_INPUT_COVARIANCE(0), q10 = READ_INPUT_COVARIANCE(1);
      const REAL q01 = READ_INPUT_COVARIANCE(2), q11 = READ_INPUT_COVARIANCE(3);
      ROWS for (int i = Q - 1; i >= 0; i--) {
        const int r = HEAD + i;
        const REAL g0 = G(i, 0), g1 = G(i, 1), g2 = G(i, 2), own = OWN(i);
        const REAL in0 = U(i, 0) * q00 + U(i, 1) * q10, in1 = U(i, 0) * q01 + U(i, 1) * q11;
        REAL by_pose[3]; /* row i of G P */
#pragma unroll
        for (int c = 0; c < 3; c++)
          by_pose[c] = g0 * SYMMETRIC(0, c) + g1 * SYMMETRIC(1, c) + g2 * SYMMETRIC(2, c) + own * P(r, c);
#if R > 0
        const int m = parameter_of[i];
        const REAL by_stored = m < 0 ? (REAL)0 : BY_STORED(i);
        const REAL with_stored = m < 0 ? (REAL)0 : P(r, 3 + m);
        if (m >= 0)
          for (int c = 0; c < 3; c++) by_pose[c] += by_stored * P(3 + m, c);
        SYNC();
        ROWS for (int c = LANE; c < R; c += GROUP) {
          REAL a = g0 * P(3 + c, 0) + g1 * P(3 + c, 1) + g2 * P(3 + c, 2) + own * P(r, 3 + c);
          if (m >= 0) a += by_stored * SYMMETRIC(3 + m, 3 + c);
          P(r, 3 + c) = a;
        }
#endif
        SYNC();
        ROWS for (int j = LANE; j <= i; j += GROUP) {
          const int c = HEAD + j;
          REAL a = g0 * P(c, 0) + g1 * P(c, 1) + g2 * P(c, 2) + own * P(r, c);
#if R > 0
          /* Row i's own entries by the parameters are those of G P already. */
          if (m >= 0) a += by_stored * (j == i ? with_stored : P(c, 3 + m));
#endif
          REAL sum = by_pose[0] * G(j, 0) + by_pose[1] * G(j, 1) + by_pose[2] * G(j, 2) + a * OWN(j);
#if R > 0
          if (parameter_of[j] >= 0) sum += P(r, 3 + parameter_of[j]) * BY_STORED(j);
#endif
          sum += in0 * U(j, 0) + in1 * U(j, 1);
          if (j == i) sum += READ_STATE_VARIANCE(3 + i);
          P(r, c) = sum;
        }
        SYNC();
        if (LANE == 0)
#pragma unroll
          for (int c = 0; c < 3; c++)
            P(r, c) = by_pose[0] * by_state[c] + by_pose[1] * by_state[c + 3] +
                      by_pose[2] * by_state[c + 6] + in0 * by_input[c] + in1 * by_input[c + 3];
      }
      ROWS for (int m = LANE; m < R; m += GROUP) {
        const REAL a = P(3 + m, 0), b = P(3 + m, 1), c = P(3 + m, 2);
#pragma unroll
        for (int i = 0; i < 3; i++)
          P(3 + m, i) = a * by_state[i] + b * by_state[i + 3] + c * by_state[i + 6];
        P(3 + m, 3 + m) += READ_STATE_VARIANCE(3 + Q + m);
      }
      {
        REAL half[9], in[6]; /* of the pose: G P and Gu Q, row by row */
#pragma unroll
        for (int i = 0; i < 3; i++) {
#pragma unroll
          for (int j = 0; j < 3; j++)
            half[3 * i + j] = by_state[i] * SYMMETRIC(0, j) + by_state[i + 3] * SYMMETRIC(1, j) +
                              by_state[i + 6] * SYMMETRIC(2, j);
          in[2 * i] = by_input[i] * q00 + by_input[i + 3] * q10;
          in[2 * i + 1] = by_input[i] * q01 + by_input[i + 3] * q11;
        }
        SYNC();
        if (LANE == 0)
#pragma unroll
          for (int i = 0; i < 3; i++)
#pragma unroll
            for (int j = 0; j <= i; j++) {
              REAL sum = half[3 * i] * by_state[j] + half[3 * i + 1] * by_state[j + 3] +
                         half[3 * i + 2] * by_state[j + 6];
              sum += in[2 * i] * by_input[j] + in[2 * i + 1] * by_input[j + 3];
              P(i, j) = i == j ? sum + READ_STATE_VARIANCE(i) : sum;
            }
        SYNC();
      }

      /* Innovations, gate and new landmarks, from the belief before any update of this stamp */
#if Q > 32
      const int in_sight = __popcll(seen);
#else
      const int in_sight = __popc(seen);
#endif
      if (!(READ_MINIMUM_VISIBLE(0) <= (REAL)in_sight)) seen = 0;
      const Bits entering = seen & ~active;
      Bits accepted = 0;
      for (int i = LANE; i < Q; i += GROUP) {
        const REAL off = Y(i) - BETA(i);
        const REAL found = off - (REAL)TWO_PI * v_ceil((off - (REAL)(TWO_PI / 2)) * (REAL)(1 / TWO_PI));
        INNOVATION(i) = found;
        TARGET(i) = found + BETA(i);
      }
      SYNC();
      ROWS for (int i = 0; i < Q; i++) {
        const REAL found = INNOVATION(i), limit = READ_GATE(0) * (P(HEAD + i, HEAD + i) + READ_VARIANCE(i));
        accepted |= (Bits)(found * found <= limit) << i;
      }
      accepted &= seen & active;
      SYNC();
      if (entering) {
        ROWS for (int i = 0; i < Q; i++) {
          const int r = HEAD + i;
          if (!BIT(entering, i)) continue;
          if (LANE == 0) BETA(i) = Y(i);
          ROWS for (int j = LANE; j < r; j += GROUP) P(r, j) = 0;
          ROWS for (int j = r + LANE; j < N; j += GROUP) P(j, r) = j == r ? READ_VARIANCE(i) : (REAL)0;
          SYNC();
        }
        active |= entering;
      }

      /* Scalar updates, one landmark after the other */
#if GROUP == 1
      REAL state[N], column[N];
#pragma unroll
      for (int j = 0; j < N; j++) state[j] = j < 3 ? x[j] : X(j);
#pragma unroll
      for (int i = 0; i < Q; i++) {
        const int r = HEAD + i;
        const bool used = BIT(accepted, i);
        doubtful |= used && !(P(r, r) > 0);
        const REAL share = used ? v_inverse(P(r, r) + READ_VARIANCE(i)) : (REAL)0;
        const REAL push = share * (TARGET(i) - state[r]);
#pragma unroll
        for (int j = 0; j < N; j++) {
          column[j] = SYMMETRIC(r, j);
          state[j] += column[j] * push;
        }
#pragma unroll
        for (int j = 0; j < N; j++) {
          const REAL gain = column[j] * share;
#pragma unroll
          for (int c = 0; c <= j; c++) P(j, c) -= gain * column[c];
        }
      }
#pragma unroll
      for (int j = 0; j < N; j++) (j < 3 ? x[j < 3 ? j : 0] : X(j)) = state[j];
#else
      for (int i = 0; i < Q; i++) {
        const int r = HEAD + i;
        if (!BIT(accepted, i)) continue;
        doubtful |= !(P(r, r) > 0);
        const REAL share = v_inverse(P(r, r) + READ_VARIANCE(i));
        const REAL push = share * (TARGET(i) - BETA(i));
        REAL column[(N + GROUP - 1) / GROUP];
#pragma unroll
        for (int m = 0; m * GROUP < N; m++) {
          const int j = m * GROUP + LANE;
          column[m] = j < N ? SYMMETRIC(r, j) : (REAL)0;
        }
#pragma unroll
        for (int j = 0; j < 3; j++) x[j] += P(r, j) * push;
        SYNC();
#pragma unroll
        for (int m = 0; m * GROUP < N; m++) {
          const int j = m * GROUP + LANE;
          if (j < N) S(AT_COLUMN + j) = column[m];
          if (3 <= j && j < N) X(j) += column[m] * push;
        }
        SYNC();
#pragma unroll 4
        for (int j = 0; j < N; j++) {
          const REAL gain = S(AT_COLUMN + j) * share;
#pragma unroll
          for (int m = 0; m * GROUP < N; m++) {
            const int c = m * GROUP + LANE;
            if (c <= j) P(j, c) -= gain * column[m];
          }
        }
        SYNC();
      }
#endif
#ifdef AT_INTEGRAL
      EACH(i, N)
        for (int c = 0; c < Q; c++)
          if (BIT(accepted, c)) S(AT_INTEGRAL + i) += READ_INTEGRAL_GAIN(i + c * N) * INNOVATION(c);
      SYNC();
#endif

/* The sum of the absolute values in the belief. For a covariance it is at most N times the trace,
 * which is used where it is small enough. */
      total = 0;
      ROWS for (int i = LANE; i < N; i += GROUP) total += P(i, i);
      total *= (REAL)N;
      ROWS for (int i = 3 + LANE; i < N; i += GROUP) total += v_abs(X(i));
      total = all_lanes(total) + v_abs(x[0]) + v_abs(x[1]) + v_abs(x[2]);
      if (!(total < MAX_BELIEF)) {
        total = 0;
        ROWS for (int i = 0; i < N; i++) {
          if (i >= 3 && i % GROUP == LANE) total += v_abs(X(i));
          ROWS for (int j = LANE; j <= i; j += GROUP)
            total += (REAL)(i == j ? 1 : 2) * v_abs(P(i, j));
        }
        total = all_lanes(total) + v_abs(x[0]) + v_abs(x[1]) + v_abs(x[2]);
      }

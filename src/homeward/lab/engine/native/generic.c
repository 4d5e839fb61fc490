/* Covariance and update of many landmarks, where unrolled code would be too large. G is dense in
 * memory, but only the entries of its pattern are read. */

static void generic_predict(V *p) {
  V *P = p + COVARIANCE, *A = p + SCRATCH, *B = A + N * N;
  const V *G = p + BY_STATE, *H = p + BY_INPUT, *S = p + INPUT_COVARIANCE;
  memset(A, 0, N * N * sizeof(V));
  for (int i = 0; i < N; i++)
    for (int e = row_start[i]; e < row_start[i + 1]; e++) {
      const int k = row_entry[e];
      const V g = G[i + k * N];
      for (int j = 0; j < N; j++) A[i * N + j] += g * P[k * N + j];
    }
  for (int i = 0; i < N; i++)
    for (int j = 0; j < N; j++) B[j * N + i] = A[i * N + j];
  for (int i = 0; i < N; i++) {
    const V a = H[i] * S[0] + H[i + N] * S[1], b = H[i] * S[2] + H[i + N] * S[3];
    for (int j = 0; j < N; j++) A[i * N + j] = a * H[j] + b * H[j + N];
    A[i * N + i] += p[STATE_VARIANCE + i];
    for (int e = row_start[i]; e < row_start[i + 1]; e++) {
      const int k = row_entry[e];
      const V g = G[i + k * N];
      for (int j = 0; j < N; j++) A[i * N + j] += g * B[k * N + j];
    }
  }
  for (int i = 0; i < N; i++)
    for (int j = 0; j <= i; j++) P[i * N + j] = P[j * N + i] = A[i * N + j];
}

static void generic_update(V *p) {
  V *x = p + STATE, *P = p + COVARIANCE, *before = p + SCRATCH, *column = before + N;
  const V *mask = p + MASK, *variance = p + VARIANCE, *y = p + BEARINGS;
  V *active = p + ACTIVE, *innovation = p + INNOVATION, *accepted = p + ACCEPTED;
  V seen = v_set(0.0);
  for (int i = 0; i < Q; i++) seen += mask[i];
  const V enough = v_le(p[MINIMUM_VISIBLE], seen);
  for (int i = 0; i < Q; i++) {
    const int j = 3 + i;
    const V visible = mask[i] * enough, entering = visible * (1.0 - active[i]);
    const V off = y[i] - x[j];
    const double turn = 6.28318530717958647693;
    innovation[i] = visible * active[i] * (off - turn * v_ceil((off - 0.5 * turn) / turn));
    p[INNOVATION_VARIANCE + i] = P[j * N + j] + variance[i];
    accepted[i] = visible * active[i] *
                  v_le(innovation[i] * innovation[i], p[GATE] * p[INNOVATION_VARIANCE + i]);
    if (v_any(entering)) {
      const V stays = 1.0 - entering;
      x[j] = stays * x[j] + entering * y[i];
      for (int k = 0; k < N; k++) P[j * N + k] = P[k * N + j] = stays * P[j * N + k];
      P[j * N + j] += entering * variance[i];
      active[i] += entering;
    }
  }
  memcpy(before, x, N * sizeof(V));
  for (int i = 0; i < Q; i++) {
    if (!v_any(accepted[i])) continue;
    const int j = 3 + i;
    const V share = accepted[i] / (P[j * N + j] + variance[i]);
    const V push = share * (innovation[i] - (x[j] - before[j]));
    memcpy(column, P + j * N, N * sizeof(V));
    for (int k = 0; k < N; k++) x[k] += column[k] * push;
    for (int k = 0; k < N; k++)
      for (int m = 0; m < N; m++) P[k * N + m] -= (column[k] * column[m]) * share;
  }
  // Some compilers fuse multiply-subtract in a loop's body, but not in its remainder.
  for (int k = 0; k < N; k++)
    for (int m = 0; m < k; m++) P[m * N + k] = P[k * N + m];
#ifdef INTEGRAL
  for (int i = 0; i < Q; i++) {
    const V used = innovation[i] * accepted[i];
    for (int k = 0; k < N; k++) p[INTEGRAL + k] += p[INTEGRAL_GAIN + i * N + k] * used;
  }
#endif
}

/* Many runs of a program: start, then score and advance until a run stops, diverges or ends. */

typedef struct {
  int64_t place, size;
  const double *data;
  int64_t by_run, by_step; /* from one run, and one step, to the next; 0 where they share */
} Given;

typedef struct {
  int64_t place, size, scale, normal; /* scale: place of sigma, or of the probability of a 1 */
  int64_t stream;
} Draw;

typedef struct {
  int64_t place, size;
  double *data;
} Kept;

typedef struct {
  int64_t runs, steps, first, stop, n_start, n_series, n_draws, n_guarded, n_sums, n_final,
      n_history;
  uint64_t seed;
  double largest;
  const Given *start, *series;
  const Draw *draws;
  const Kept *guarded, *sums, *final, *history;
  int64_t *samples;
  uint8_t *stopped, *diverged;
} Job;

static void take(const Given *given, int64_t count, const int64_t *run, int64_t step, V *p) {
  for (const Given *g = given; g < given + count; g++)
    for (int64_t i = 0; i < g->size; i++)
      for (int l = 0; l < LANES; l++)
        v_put(p[g->place + i], l, g->data[run[l] * g->by_run + step * g->by_step + i]);
}

static void draw(const Job *job, WU number, int64_t step, V *p) {
  for (const Draw *d = job->draws; d < job->draws + job->n_draws; d++)
    for (int64_t i = 0; i < d->size; i += 2) {
      W two[2];
      (d->normal ? normals : uniforms)(job->seed, number, step, (d->stream << 16) + i / 2, two);
      for (int64_t j = 0; j < 2 && i + j < d->size; j++) {
        const V scale = p[d->scale + i + j];
#ifdef SINGLE
        const V x = two[j][0];
#else
        const V x = two[j];
#endif
        p[d->place + i + j] = d->normal ? x * scale : v_lt(x, scale);
      }
    }
}

/* 1 in lanes where the guarded numbers are too large or NaN. */
static V lost(const Job *job, const V *p) {
  V sum[8] = {0}; /* hides the latency of additions */
  for (const Kept *k = job->guarded; k < job->guarded + job->n_guarded; k++) {
    int64_t i = 0;
    for (; i + 8 <= k->size; i += 8)
      for (int j = 0; j < 8; j++) sum[j] += v_abs(p[k->place + i + j]);
    for (; i < k->size; i++) sum[0] += v_abs(p[k->place + i]);
  }
  for (int j = 1; j < 8; j++) sum[0] += sum[j];
  return 1.0 - v_lt(sum[0], v_set(job->largest));
}

static void keep(const Kept *kept, int64_t count, int64_t run, int lane, int64_t row,
                 int64_t rows, int add, const V *p) {
  for (const Kept *k = kept; k < kept + count; k++) {
    double *to = k->data + (run * rows + row) * k->size;
    for (int64_t i = 0; i < k->size; i++) to[i] = v_at(p[k->place + i], lane) + (add ? to[i] : 0.0);
  }
}

/* LANES runs in lanes, from number `first` on; runs past `end` only fill lanes. */
static void together(const Job *job, int64_t first, int64_t end, V *p) {
  int64_t run[LANES];
  int going[LANES], left = 0;
  WU number;
  for (int l = 0; l < LANES; l++) {
    run[l] = first + l < end ? first + l : end - 1;
    left += going[l] = first + l < end;
  }
  for (int l = 0; l < WIDTH; l++) number[l] = (uint64_t)(job->first + run[l < LANES ? l : 0]);
  memset(p, 0, POOL * sizeof(V));
  take(job->start, job->n_start, run, 0, p);
  for (int64_t k = 0;; k++) {
    observe(p);
    const V bad = lost(job, p);
    for (int l = 0; l < LANES; l++) {
      if (!going[l]) continue;
      const int diverged = v_at(bad, l) != 0.0;
      const int stopped = !diverged && job->stop >= 0 && v_at(p[job->stop], l) != 0.0;
      if (!diverged) {
        job->samples[run[l]] = k + 1;
        keep(job->sums, job->n_sums, run[l], l, 0, 1, 1, p);
        keep(job->final, job->n_final, run[l], l, 0, 1, 0, p);
        keep(job->history, job->n_history, run[l], l, k, job->steps + 1, 0, p);
      }
      job->diverged[run[l]] = (uint8_t)diverged;
      job->stopped[run[l]] = (uint8_t)stopped;
      if (diverged || stopped) going[l] = 0, left--;
    }
    if (k == job->steps || left == 0) break;
    take(job->series, job->n_series, run, k, p);
    draw(job, number, k, p);
    advance(p);
  }
}

int32_t homeward_lanes(void) { return LANES; }

/* Runs `begin` to `end` of a job, which several threads may share. Returns 1 without memory. */
int32_t homeward_batch(const Job *job, int64_t begin, int64_t end) {
  V *p = aligned_alloc(64, (POOL * sizeof(V) + 63) / 64 * 64);
  if (!p) return 1;
  for (int64_t r = begin; r < end; r += LANES) together(job, r, end, p);
  free(p);
  return 0;
}

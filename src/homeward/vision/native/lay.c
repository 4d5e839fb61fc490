/* Patches of one panorama laid onto another: affine Lucas-Kanade, as in alignment.py. */

#define SHAPES 6 /* parameters of a map: shift, then the matrix row by row */
#define LANES 16 /* sums side by side: grids are filled up to a multiple with points of no weight */

/* A panorama: its levels' addresses, heights and widths, and how the first lies in it. */
typedef struct {
  const int64_t (*levels)[3];
  double times, width, margin;
  long count;
} Picture;

/* A patch's own coordinates, in radii, and the root of its weight. */
typedef struct {
  long points;
  const float *across, *down, *root;
} Grid;

static Picture picture_of(long count, const int64_t *levels, const double *layout) {
  return (Picture){(const int64_t(*)[3])levels, layout[0], layout[1], layout[2], count};
}

static float dot(long n, const float *a, const float *b) {
  float sums[LANES] = {0.0f}, sum = 0.0f;
  for (long i = 0; i < n; i += LANES)
    for (int q = 0; q < LANES; q++) sums[q] += a[i + q] * b[i + q];
  for (int q = 0; q < LANES; q++) sum += sums[q];
  return sum;
}

static void subtract(long n, float times, const float *known, float *from) {
  for (long i = 0; i < n; i++) from[i] -= times * known[i];
}

/* Values (height, width) between pixels, at n places that `map` (2, 3) makes of across and down.
 * Not inlined: compilers then still know that arrays do not overlap, and take several at once. */
__attribute__((noinline)) static void interpolate(long n, const float *restrict across,
                                                  const float *restrict down, const float *map,
                                                  const float *restrict values, int height,
                                                  int width, float *restrict found) {
  const float xu = map[0], xv = map[1], x0 = map[2], yu = map[3], yv = map[4], y0 = map[5];
  const float last = (float)(width - 1), lowest = (float)(height - 1);
  for (long i = 0; i < n; i++) {
    float x = xu * across[i] + (xv * down[i] + x0), y = yu * across[i] + (yv * down[i] + y0);
    x = x > 0.0f ? x : 0.0f; /* NaN: 0 */
    y = y > 0.0f ? y : 0.0f;
    x = x < last ? x : last;
    y = y < lowest ? y : lowest;
    const int left = (int)x, top = (int)y;
    const int right = left + (left + 1 < width), below = top + (top + 1 < height);
    const float a = x - (float)left, b = y - (float)top;
    const float upper = values[top * width + left], lower = values[below * width + left];
    const float high = upper + a * (values[top * width + right] - upper);
    const float low = lower + a * (values[below * width + right] - lower);
    found[i] = high + b * (low - high);
  }
}

/* Grey values at the points of a grid that `map` (2, 3) carries into the picture. */
static void sample(const Picture *p, const Grid *grid, const double *map, double spacing,
                   float *grey) {
  const long k = (long)clipped(rint(log2(spacing * p->times)), 0.0, (double)(p->count - 1));
  const double around = floor((map[2] + 0.5) / p->width) * p->width;
  const double part = 1.0 / (double)(1L << k), scale = p->times * part;
  const double x0 = (map[2] - around + 0.5) * scale - (0.5 - p->margin) * part;
  const double y0 = (map[5] + 0.5) * scale - 0.5 * part;
  const float carry[6] = {
      (float)(map[0] * scale), (float)(map[1] * scale), (float)x0,
      (float)(map[3] * scale), (float)(map[4] * scale), (float)y0,
  };
  const float *values = (const float *)(intptr_t)p->levels[k][0];
  interpolate(grid->points, grid->across, grid->down, carry, values, (int)p->levels[k][1],
              (int)p->levels[k][2], grey);
}

/* Weigh a patch, and give it zero mean and unit length; returned is the length that it had. */
static float normalise(const Grid *grid, float *grey) {
  const long n = grid->points;
  for (long i = 0; i < n; i++) grey[i] *= grid->root[i];
  subtract(n, dot(n, grey, grid->root), grid->root, grey);
  const float length = fmaxf(sqrtf(dot(n, grey, grey)), 1e-3f);
  for (long i = 0; i < n; i++) grey[i] /= length;
  return length;
}

/* The patch about a place at home, and how it changes with the map, (SHAPES, points). */
static void template_of(const Picture *home, const Grid *grid, const double *at, double radius,
                        double half, float *patch, float *slopes) {
  const long n = grid->points;
  const double spacing = radius / half;
  const double map[6] = {radius, 0.0, at[0], 0.0, radius, at[1]};
  float sides[2][n];
  sample(home, grid, map, spacing, patch);
  const float by = (float)half / normalise(grid, patch);
  for (int way = 0; way < 2; way++) {
    for (int side = 0; side < 2; side++) {
      double shifted[6];
      for (int q = 0; q < 6; q++) shifted[q] = map[q];
      shifted[way ? 5 : 2] += (side - 0.5) * spacing;
      sample(home, grid, shifted, spacing, sides[side]);
    }
    float *shift = slopes + way * n, *across = slopes + (2 + 2 * way) * n, *down = across + n;
    for (long i = 0; i < n; i++) {
      shift[i] = (sides[1][i] - sides[0][i]) * grid->root[i] * by;
      across[i] = shift[i] * grid->across[i];
      down[i] = shift[i] * grid->down[i];
    }
  }
  for (int j = 0; j < SHAPES; j++) { /* what changes but the mean or the length is taken out */
    float *slope = slopes + j * n;
    subtract(n, dot(n, slope, grid->root), grid->root, slope);
    subtract(n, dot(n, slope, patch), patch, slope);
  }
}

/* Lower Cholesky root in the place of a matrix; 1 if it is not positive definite. */
static int root_of(double (*m)[SHAPES]) {
  for (int i = 0; i < SHAPES; i++)
    for (int q = 0; q <= i; q++) {
      double sum = m[i][q];
      for (int k = 0; k < q; k++) sum -= m[i][k] * m[q][k];
      if (i == q && !(sum > 0.0)) return 1;
      m[i][q] = i == q ? sqrt(sum) : sum / m[q][q];
    }
  return 0;
}

/* Solve with that root, in the place of the right side. */
static void solve(double (*root)[SHAPES], double *x) {
  for (int i = 0; i < SHAPES; i++) {
    for (int k = 0; k < i; k++) x[i] -= root[i][k] * x[k];
    x[i] /= root[i][i];
  }
  for (int i = SHAPES - 1; i >= 0; i--) {
    for (int k = i + 1; k < SHAPES; k++) x[i] -= root[k][i] * x[k];
    x[i] /= root[i][i];
  }
}

/* Undo a step of a map (2, 3): map times the inverse of what the step stands for. */
static void undo(const double *step, double least, double *map) {
  const double a = 1.0 + step[2], b = step[3], c = step[4], d = 1.0 + step[5];
  const double area = fmax(a * d - b * c, least);
  const double inverse[4] = {d / area, -b / area, -c / area, a / area};
  const double x = inverse[0] * step[0] + inverse[1] * step[1];
  const double y = inverse[2] * step[0] + inverse[3] * step[1];
  for (double *row = map; row < map + 6; row += 3) {
    const double u = row[0], v = row[1];
    row[0] = u * inverse[0] + v * inverse[2];
    row[1] = u * inverse[1] + v * inverse[3];
    row[2] -= u * x + v * y;
  }
}

/* Lay n patches about places `at` (n, 2) of home, of some `radius` (n), onto the panorama now: maps
 * `carried` (n, 2, 3) begin as features say, with radius `reach` (n), and end where the patches
 * agree best. Also returned: how alike they then are, and the covariance (n, 2, 2) of the places for
 * noise of one grey value. 1 if some matrix is not positive definite. */
int lay(long n, long points, long steps, const double *limits, const double *prior,
        const float *grids, long home_count, const int64_t *home_levels, const double *home_layout,
        long now_count, const int64_t *now_levels, const double *now_layout, const double *at,
        const double *radius, const double *reach, double *carried, double *likeness,
        double *spread) {
  const double half = limits[0], longest = limits[1], least = limits[2];
  const Grid grid = {points, grids, grids + points, grids + 2 * points};
  const Picture home = picture_of(home_count, home_levels, home_layout);
  const Picture now = picture_of(now_count, now_levels, now_layout);
  float patch[points], laid[points], slopes[SHAPES * points];
  double root[SHAPES][SHAPES];
  if (points % LANES) return 1;
  for (long m = 0; m < n; m++) {
    double *map = carried + 6 * m, step[SHAPES];
    const double *place = at + 2 * m;
    /* One feature is laid after several maps in turn: its patch is the same. */
    if (!m || place[0] != place[-2] || place[1] != place[-1] || radius[m] != radius[m - 1]) {
      template_of(&home, &grid, place, radius[m], half, patch, slopes);
      for (int j = 0; j < SHAPES; j++)
        for (int q = 0; q <= j; q++)
          root[j][q] = dot(points, slopes + j * points, slopes + q * points) + (j == q) * prior[j];
      if (root_of(root)) return 1;
    }
    const double size = map[0] * map[4] - map[1] * map[3];
    const double back[2][2] = {{map[4] / size, -map[1] / size}, {-map[3] / size, map[0] / size}};
    for (long k = 0;; k++) {
      sample(&now, &grid, map, reach[m] / half, laid);
      normalise(&grid, laid);
      likeness[m] = dot(points, laid, patch);
      if (k == steps) break;
      subtract(points, 1.0f, patch, laid);
      for (int j = 0; j < SHAPES; j++) step[j] = dot(points, laid, slopes + j * points);
      for (int i = 0; i < 2; i++)
        for (int q = 0; q < 2; q++) {
          const double shape = back[i][0] * map[q] + back[i][1] * map[3 + q] - (i == q);
          step[2 + 2 * i + q] += shape * prior[2 + 2 * i + q];
        }
      solve(root, step);
      for (int j = 0; j < SHAPES; j++) step[j] = clipped(step[j], -longest, longest);
      undo(step, least, map);
    }
    double x[SHAPES] = {1.0}, y[SHAPES] = {0.0, 1.0};
    solve(root, x);
    solve(root, y);
    for (int i = 0; i < 2; i++) {
      spread[4 * m + i] = x[i];
      spread[4 * m + 2 + i] = y[i];
    }
  }
  return 0;
}

/* Patches of one panorama laid onto another: affine Lucas-Kanade, as in alignment.py. */

#define SHAPES 6 /* parameters of a map: shift, then the matrix row by row */
#define LANES 16 /* points side by side: grids are filled up to a multiple with some of no weight */

typedef float Block __attribute__((vector_size(4 * LANES)));

/* A panorama: its levels' addresses, heights and widths, and how the first lies in it. */
typedef struct {
  const int64_t (*levels)[3];
  double times, width, margin;
  long count;
} Pyramid;

/* One level of it: `scale` times as large as the panorama. */
typedef struct {
  const float *values;
  int height, width;
  double scale, left, top, around;
} Level;

/* A patch's own coordinates, in radii, and the root of its weight. */
typedef struct {
  long blocks;
  const float *across, *down;
  const Block *root;
} Grid;

static Pyramid pyramid_of(long count, const int64_t *levels, const double *layout) {
  return (Pyramid){(const int64_t(*)[3])levels, layout[0], layout[1], layout[2], count};
}

/* The level on which points that are `spacing` apart are looked up. */
static Level level_of(const Pyramid *p, double spacing) {
  const long k = (long)clipped(rint(log2(spacing * p->times)), 0.0, (double)(p->count - 1));
  const double part = 1.0 / (double)(1L << k), scale = p->times * part;
  const double left = 0.5 * scale - (0.5 - p->margin) * part, top = 0.5 * scale - 0.5 * part;
  return (Level){(const float *)(intptr_t)p->levels[k][0], (int)p->levels[k][1],
                 (int)p->levels[k][2], scale, left, top, p->width};
}

/* Whether a row has fewer than the two values that are fetched together. */
static int is_narrow(const Pyramid *p) { return p->levels[p->count - 1][2] < 2; }

static float sum(Block block) {
  float lanes[LANES];
  memcpy(lanes, &block, sizeof block);
  for (int half = LANES / 2; half; half /= 2)
    for (int q = 0; q < half; q++) lanes[q] += lanes[q + half];
  return lanes[0];
}

static float dot(long blocks, const Block *a, const Block *b) {
  Block sums = {0.0f};
  for (long i = 0; i < blocks; i++) sums += a[i] * b[i];
  return sum(sums);
}

/* Products with each of the slopes, (SHAPES, blocks). */
static void dots(long blocks, const Block *a, const Block *slopes, double *found) {
  Block sums[SHAPES] = {{0.0f}};
  for (long i = 0; i < blocks; i++)
    for (int j = 0; j < SHAPES; j++) sums[j] += a[i] * slopes[j * blocks + i];
  for (int j = 0; j < SHAPES; j++) found[j] = sum(sums[j]);
}

/* Values (height, width) between pixels, at n places that `map` (2, 3) makes of across and down.
 * Neighbours in a row are fetched together. Not inlined: compilers then still know that arrays do
 * not overlap, and compute several at once. */
EACH_PROCESSOR
__attribute__((noinline)) static void interpolate(long n, const float *restrict across,
                                                  const float *restrict down, const float *map,
                                                  const float *restrict values, int height,
                                                  int width, float *restrict found) {
  const float xu = map[0], xv = map[1], x0 = map[2], yu = map[3], yv = map[4], y0 = map[5];
  const float last = (float)(width - 1), lowest = (float)(height - 1);
  const int below = height > 1 ? width : 0;
  for (long i = 0; i < n; i += LANES) {
    int place[LANES];
    float a[LANES], b[LANES], upper[LANES][2], lower[LANES][2];
    for (int q = 0; q < LANES; q++) {
      float x = xu * across[i + q] + (xv * down[i + q] + x0);
      float y = yu * across[i + q] + (yv * down[i + q] + y0);
      x = x > 0.0f ? x : 0.0f; /* NaN: 0 */
      y = y > 0.0f ? y : 0.0f;
      x = x < last ? x : last;
      y = y < lowest ? y : lowest;
      int left = (int)x, top = (int)y;
      left = left < width - 2 ? left : width - 2;
      top = top + 1 < height ? top : top - (height > 1);
      place[q] = top * width + left;
      a[q] = x - (float)left;
      b[q] = y - (float)top;
    }
    for (int q = 0; q < LANES; q++) {
      memcpy(upper[q], values + place[q], sizeof upper[q]);
      memcpy(lower[q], values + place[q] + below, sizeof lower[q]);
    }
    for (int q = 0; q < LANES; q++) {
      const float left = upper[q][0] + b[q] * (lower[q][0] - upper[q][0]);
      const float right = upper[q][1] + b[q] * (lower[q][1] - upper[q][1]);
      found[i + q] = left + a[q] * (right - left);
    }
  }
}

/* Grey values at the points of a grid that `map` (2, 3) carries into a panorama. */
static void sample(const Level *level, const Grid *grid, const double *map, Block *grey) {
  const double around = floor((map[2] + 0.5) / level->around) * level->around;
  const double scale = level->scale;
  const float carry[6] = {
      (float)(map[0] * scale), (float)(map[1] * scale),
      (float)((map[2] - around) * scale + level->left),
      (float)(map[3] * scale), (float)(map[4] * scale), (float)(map[5] * scale + level->top),
  };
  interpolate(LANES * grid->blocks, grid->across, grid->down, carry, level->values, level->height,
              level->width, (float *)grey);
}

/* Weigh a patch, and give it zero mean and unit length; returned is the length that it had. */
static float normalise(const Grid *grid, Block *grey) {
  const long n = grid->blocks;
  Block means = {0.0f}, squares = {0.0f};
  for (long i = 0; i < n; i++) {
    grey[i] *= grid->root[i];
    means += grey[i] * grid->root[i];
  }
  const float mean = sum(means);
  for (long i = 0; i < n; i++) {
    grey[i] -= mean * grid->root[i];
    squares += grey[i] * grey[i];
  }
  const float length = fmaxf(sqrtf(sum(squares)), 1e-3f), part = 1.0f / length;
  for (long i = 0; i < n; i++) grey[i] *= part;
  return length;
}

/* The patch about a place at home, and how it changes with the map, (SHAPES, blocks). */
static void template_of(const Pyramid *home, const Grid *grid, const double *at, double radius,
                        double half, Block *patch, Block *slopes) {
  const long n = grid->blocks;
  const double spacing = radius / half;
  const double map[6] = {radius, 0.0, at[0], 0.0, radius, at[1]};
  const Level level = level_of(home, spacing);
  const Block *across = (const Block *)grid->across, *down = (const Block *)grid->down;
  Block sides[2][n];
  sample(&level, grid, map, patch);
  const float by = (float)half / normalise(grid, patch);
  for (int way = 0; way < 2; way++) {
    for (int side = 0; side < 2; side++) {
      double shifted[6];
      for (int q = 0; q < 6; q++) shifted[q] = map[q];
      shifted[way ? 5 : 2] += (side - 0.5) * spacing;
      sample(&level, grid, shifted, sides[side]);
    }
    Block *shift = slopes + way * n, *turned = slopes + (2 + 2 * way) * n;
    for (long i = 0; i < n; i++) {
      shift[i] = (sides[1][i] - sides[0][i]) * grid->root[i] * by;
      turned[i] = shift[i] * across[i];
      turned[n + i] = shift[i] * down[i];
    }
  }
  /* What changes but the mean or the length is taken out. */
  double means[SHAPES], lengths[SHAPES];
  dots(n, grid->root, slopes, means);
  dots(n, patch, slopes, lengths);
  for (int j = 0; j < SHAPES; j++) {
    const float mean = (float)means[j], length = (float)lengths[j];
    for (long i = 0; i < n; i++) slopes[j * n + i] -= mean * grid->root[i] + length * patch[i];
  }
}

/* Lower Cholesky root in the place of a matrix, but for its diagonal, of which the inverse is kept;
 * 1 if the matrix is not positive definite. */
static int root_of(double (*m)[SHAPES]) {
  for (int i = 0; i < SHAPES; i++)
    for (int q = 0; q <= i; q++) {
      double rest = m[i][q];
      for (int k = 0; k < q; k++) rest -= m[i][k] * m[q][k];
      if (i == q && !(rest > 0.0)) return 1;
      m[i][q] = i == q ? 1.0 / sqrt(rest) : rest * m[q][q];
    }
  return 0;
}

/* Solve with that root, in the place of the right side. */
static void solve(double (*root)[SHAPES], double *x) {
  for (int i = 0; i < SHAPES; i++) {
    for (int k = 0; k < i; k++) x[i] -= root[i][k] * x[k];
    x[i] *= root[i][i];
  }
  for (int i = SHAPES - 1; i >= 0; i--) {
    for (int k = i + 1; k < SHAPES; k++) x[i] -= root[k][i] * x[k];
    x[i] *= root[i][i];
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
 * noise of one grey value. 1 if some matrix is not positive definite or a picture too narrow. */
EACH_PROCESSOR
int align(long n, long points, long steps, const double *limits, const double *prior,
        const float *grids, long home_count, const int64_t *home_levels, const double *home_layout,
        long now_count, const int64_t *now_levels, const double *now_layout, const double *at,
        const double *radius, const double *reach, double *carried, double *likeness,
        double *spread) {
  const double half = limits[0], longest = limits[1], least = limits[2];
  const long blocks = points / LANES;
  Block kept[3 * blocks], patch[blocks], laid[blocks], slopes[SHAPES * blocks];
  memcpy(kept, grids, sizeof kept); /* for they may stand anywhere */
  const Grid grid = {blocks, (float *)kept, (float *)(kept + blocks), kept + 2 * blocks};
  const Pyramid home = pyramid_of(home_count, home_levels, home_layout);
  const Pyramid now = pyramid_of(now_count, now_levels, now_layout);
  double root[SHAPES][SHAPES];
  if (points % LANES || is_narrow(&home) || is_narrow(&now)) return 1;
  for (long m = 0; m < n; m++) {
    double *map = carried + 6 * m, step[SHAPES];
    const double *place = at + 2 * m;
    /* One feature is laid after several maps in turn: its patch is the same. */
    if (!m || place[0] != place[-2] || place[1] != place[-1] || radius[m] != radius[m - 1]) {
      template_of(&home, &grid, place, radius[m], half, patch, slopes);
      for (int j = 0; j < SHAPES; j++) {
        dots(blocks, slopes + j * blocks, slopes, root[j]);
        root[j][j] += prior[j];
      }
      if (root_of(root)) return 1;
    }
    const double size = map[0] * map[4] - map[1] * map[3];
    const double back[2][2] = {{map[4] / size, -map[1] / size}, {-map[3] / size, map[0] / size}};
    const Level level = level_of(&now, reach[m] / half);
    for (long k = 0;; k++) {
      sample(&level, &grid, map, laid);
      normalise(&grid, laid);
      if (k == steps) break;
      dots(blocks, laid, slopes, step); /* to which the patch itself adds nothing */
      for (int i = 0; i < 2; i++)
        for (int q = 0; q < 2; q++) {
          const double shape = back[i][0] * map[q] + back[i][1] * map[3 + q] - (i == q);
          step[2 + 2 * i + q] += shape * prior[2 + 2 * i + q];
        }
      solve(root, step);
      for (int j = 0; j < SHAPES; j++) step[j] = clipped(step[j], -longest, longest);
      undo(step, least, map);
    }
    likeness[m] = dot(blocks, laid, patch);
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

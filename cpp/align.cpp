// Patches of one panorama aligned with another: affine Lucas-Kanade, as in
// vision/features/patch_alignment.py.
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <vector>

#include "common.h"

namespace homeward {
namespace {

constexpr int SHAPES = 6;  // parameters of a map: shift, then the matrix row by row
constexpr int LANES = 16;  // points computed together: grids are padded with points of weight zero

// Also at addresses that are not a multiple of its size, as those of arrays.
typedef float Block __attribute__((vector_size(4 * LANES), aligned(4), may_alias));

// A level of a pyramid, `scale` times as large as the panorama.
struct Level {
  const float *values;
  int height, width;
  double scale, left, top, period;
};

// A smoothed panorama at several scales, and the position of the first level in it.
struct Pyramid {
  std::vector<Array<const float>> levels;
  double times, width, margin;

  // Level for points at a distance of `spacing` [px].
  Level level(double spacing) const {
    const double last = static_cast<double>(levels.size()) - 1.0;
    const size_t k = static_cast<size_t>(clipped(std::rint(std::log2(spacing * times)), 0.0, last));
    const double part = 1.0 / static_cast<double>(1L << k), scale = times * part;
    const double left = 0.5 * scale - (0.5 - margin) * part, top = 0.5 * scale - 0.5 * part;
    const Array<const float> &grey = levels[k];
    return {grey.data(), static_cast<int>(grey.shape(0)), static_cast<int>(grey.shape(1)), scale,
            left, top, width};
  }
};

// Coordinates of a patch's points, in radii, and the root of their weights.
struct Grid {
  long blocks;
  const Block *across, *down, *root;
};

float sum(const Block &block) {
  float lanes[LANES];
  std::memcpy(lanes, &block, sizeof block);
  for (int half = LANES / 2; half; half /= 2)
    for (int q = 0; q < half; q++) lanes[q] += lanes[q + half];
  return lanes[0];
}

float dot(long blocks, const Block *a, const Block *b) {
  Block sums = {};
  for (long i = 0; i < blocks; i++) sums += a[i] * b[i];
  return sum(sums);
}

// Products with each of the slopes, (SHAPES, blocks).
void dots(long blocks, const Block *a, const Block *slopes, double *products) {
  Block sums[SHAPES] = {};
  for (long i = 0; i < blocks; i++)
    for (int j = 0; j < SHAPES; j++) sums[j] += a[i] * slopes[j * blocks + i];
  for (int j = 0; j < SHAPES; j++) products[j] = sum(sums[j]);
}

// Values (height, width) between pixels, at n points that `map` (2, 3) makes of across and down.
// Neighbours in a row are loaded together. Not inlined: compilers then still assume that arrays do
// not overlap, and vectorise.
__attribute__((noinline)) void interpolate(long n, const float *__restrict across,
                                           const float *__restrict down, const float *map,
                                           const float *__restrict values, int height, int width,
                                           float *__restrict grey) {
  const float xu = map[0], xv = map[1], x0 = map[2], yu = map[3], yv = map[4], y0 = map[5];
  const float last = static_cast<float>(width - 1), lowest = static_cast<float>(height - 1);
  const int below = height > 1 ? width : 0;
  for (long i = 0; i < n; i += LANES) {
    int place[LANES];
    float a[LANES], b[LANES], upper[LANES][2], lower[LANES][2];
    for (int q = 0; q < LANES; q++) {
      float x = xu * across[i + q] + (xv * down[i + q] + x0);
      float y = yu * across[i + q] + (yv * down[i + q] + y0);
      x = x > 0.0f ? x : 0.0f;  // NaN: 0
      y = y > 0.0f ? y : 0.0f;
      x = x < last ? x : last;
      y = y < lowest ? y : lowest;
      int left = static_cast<int>(x), top = static_cast<int>(y);
      left = left < width - 2 ? left : width - 2;
      top = top + 1 < height ? top : top - (height > 1);
      place[q] = top * width + left;
      a[q] = x - static_cast<float>(left);
      b[q] = y - static_cast<float>(top);
    }
    for (int q = 0; q < LANES; q++) {
      std::memcpy(upper[q], values + place[q], sizeof upper[q]);
      std::memcpy(lower[q], values + place[q] + below, sizeof lower[q]);
    }
    for (int q = 0; q < LANES; q++) {
      const float left = upper[q][0] + b[q] * (lower[q][0] - upper[q][0]);
      const float right = upper[q][1] + b[q] * (lower[q][1] - upper[q][1]);
      grey[i + q] = left + a[q] * (right - left);
    }
  }
}

// Grey values at the points of a grid that `map` (2, 3) projects into a panorama.
void sample(const Level &level, const Grid &grid, const double *map, Block *grey) {
  const double seam = std::floor((map[2] + 0.5) / level.period) * level.period;
  const double scale = level.scale;
  const double pixels[6] = {map[0] * scale, map[1] * scale, (map[2] - seam) * scale + level.left,
                            map[3] * scale, map[4] * scale, map[5] * scale + level.top};
  float single[6];
  for (int q = 0; q < 6; q++) single[q] = static_cast<float>(pixels[q]);
  interpolate(LANES * grid.blocks, reinterpret_cast<const float *>(grid.across),
              reinterpret_cast<const float *>(grid.down), single, level.values, level.height,
              level.width, reinterpret_cast<float *>(grey));
}

// Weight a patch, and give it zero mean and unit length; return its length before.
float normalise(const Grid &grid, Block *grey) {
  Block means = {}, squares = {};
  for (long i = 0; i < grid.blocks; i++) {
    grey[i] *= grid.root[i];
    means += grey[i] * grid.root[i];
  }
  const float mean = sum(means);
  for (long i = 0; i < grid.blocks; i++) {
    grey[i] -= mean * grid.root[i];
    squares += grey[i] * grey[i];
  }
  const float length = std::fmax(std::sqrt(sum(squares)), 1e-3f), inverse = 1.0f / length;
  for (long i = 0; i < grid.blocks; i++) grey[i] *= inverse;
  return length;
}

// The patch around a position at home, and its derivatives by the map, (SHAPES, blocks). `sides` is
// scratch, (2, blocks).
void make_template(const Pyramid &home, const Grid &grid, const double *at, double radius,
                   double half, Block *patch, Block *slopes, Block *sides) {
  const long n = grid.blocks;
  const double spacing = radius / half;
  const double map[6] = {radius, 0.0, at[0], 0.0, radius, at[1]};
  const Level level = home.level(spacing);
  sample(level, grid, map, patch);
  const float factor = static_cast<float>(half) / normalise(grid, patch);
  for (int axis = 0; axis < 2; axis++) {
    for (int side = 0; side < 2; side++) {
      double shifted[6];
      std::copy(map, map + 6, shifted);
      shifted[axis ? 5 : 2] += (side - 0.5) * spacing;
      sample(level, grid, shifted, sides + side * n);
    }
    Block *shift = slopes + axis * n, *turned = slopes + (2 + 2 * axis) * n;
    for (long i = 0; i < n; i++) {
      shift[i] = (sides[n + i] - sides[i]) * grid.root[i] * factor;
      turned[i] = shift[i] * grid.across[i];
      turned[n + i] = shift[i] * grid.down[i];
    }
  }
  // Remove what changes only the mean or the length.
  double means[SHAPES], lengths[SHAPES];
  dots(n, grid.root, slopes, means);
  dots(n, patch, slopes, lengths);
  for (int j = 0; j < SHAPES; j++) {
    const float mean = static_cast<float>(means[j]), length = static_cast<float>(lengths[j]);
    for (long i = 0; i < n; i++) slopes[j * n + i] -= mean * grid.root[i] + length * patch[i];
  }
}

// Replace a matrix by its lower Cholesky factor, with the inverse of its diagonal; return false if
// the matrix is not positive definite.
bool factorise(double (*m)[SHAPES]) {
  for (int i = 0; i < SHAPES; i++)
    for (int q = 0; q <= i; q++) {
      double rest = m[i][q];
      for (int k = 0; k < q; k++) rest -= m[i][k] * m[q][k];
      if (i == q && !(rest > 0.0)) return false;
      m[i][q] = i == q ? 1.0 / std::sqrt(rest) : rest * m[q][q];
    }
  return true;
}

// Solve with that factor, in place of the right side.
void solve(const double (*factor)[SHAPES], double *x) {
  for (int i = 0; i < SHAPES; i++) {
    for (int k = 0; k < i; k++) x[i] -= factor[i][k] * x[k];
    x[i] *= factor[i][i];
  }
  for (int i = SHAPES - 1; i >= 0; i--) {
    for (int k = i + 1; k < SHAPES; k++) x[i] -= factor[k][i] * x[k];
    x[i] *= factor[i][i];
  }
}

// Undo a step in a map (2, 3): multiply it by the inverse of the step's map.
void undo(const double *step, double min_area, double *map) {
  const double a = 1.0 + step[2], b = step[3], c = step[4], d = 1.0 + step[5];
  const double area = std::fmax(a * d - b * c, min_area);
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

// Patches to align, and the results; see `align`.
struct Task {
  Pyramid home, now;
  const float *grids;
  long n, blocks, steps;
  double half, max_step, min_area;
  const double *prior, *at, *radius, *reach;
  double *maps, *correlation, *spread;
};

// Align all patches; return false if a matrix is not positive definite.
bool run(const Task &task) {
  const long blocks = task.blocks;
  std::vector<float> memory((1 + 1 + SHAPES + 2) * blocks * LANES);
  Block *const patch = reinterpret_cast<Block *>(memory.data()), *const now = patch + blocks;
  Block *const slopes = now + blocks, *const sides = slopes + SHAPES * blocks;
  const Block *const grids = reinterpret_cast<const Block *>(task.grids);
  const Grid grid = {blocks, grids, grids + blocks, grids + 2 * blocks};
  const double *prior = task.prior;
  double factor[SHAPES][SHAPES];
  for (long m = 0; m < task.n; m++) {
    double *map = task.maps + 6 * m, step[SHAPES];
    const double *at = task.at + 2 * m;
    // A feature can be aligned from several maps in turn: its patch is the same.
    if (!m || at[0] != at[-2] || at[1] != at[-1] || task.radius[m] != task.radius[m - 1]) {
      make_template(task.home, grid, at, task.radius[m], task.half, patch, slopes, sides);
      for (int j = 0; j < SHAPES; j++) {
        dots(blocks, slopes + j * blocks, slopes, factor[j]);
        factor[j][j] += prior[j];
      }
      if (!factorise(factor)) return false;
    }
    const double size = map[0] * map[4] - map[1] * map[3];
    const double back[2][2] = {{map[4] / size, -map[1] / size}, {-map[3] / size, map[0] / size}};
    const Level level = task.now.level(task.reach[m] / task.half);
    for (long k = 0;; k++) {
      sample(level, grid, map, now);
      normalise(grid, now);
      if (k == task.steps) break;
      dots(blocks, now, slopes, step);  // the patch itself contributes nothing
      for (int i = 0; i < 2; i++)
        for (int q = 0; q < 2; q++) {
          const double shape = back[i][0] * map[q] + back[i][1] * map[3 + q] - (i == q);
          step[2 + 2 * i + q] += shape * prior[2 + 2 * i + q];
        }
      solve(factor, step);
      for (double &value : step) value = clipped(value, -task.max_step, task.max_step);
      undo(step, task.min_area, map);
    }
    task.correlation[m] = dot(blocks, now, patch);
    double x[SHAPES] = {1.0}, y[SHAPES] = {0.0, 1.0};
    solve(factor, x);
    solve(factor, y);
    for (int i = 0; i < 2; i++) {
      task.spread[4 * m + i] = x[i];
      task.spread[4 * m + 2 + i] = y[i];
    }
  }
  return true;
}

using Levels = std::vector<Array<const float>>;

Pyramid pyramid(const Levels &levels, const Array<const double> &layout) {
  require_shape("layout", layout, {3});
  if (levels.empty()) throw nb::value_error("a pyramid without levels");
  for (const auto &grey : levels)
    if (grey.ndim() != 2 || grey.shape(0) < 1 || grey.shape(1) < 2)  // pixels are loaded in pairs
      throw nb::value_error("a level of a pyramid is narrower than 2 px");
  return {levels, layout.data()[0], layout.data()[1], layout.data()[2]};
}

void align(const Levels &home_levels, const Array<const double> &home_layout,
           const Levels &now_levels, const Array<const double> &now_layout,
           const Array<const float> &grids, const Array<const double> &limits,
           const Array<const double> &prior, long steps, const Array<const double> &at,
           const Array<const double> &radius, const Array<const double> &reach, Array<double> maps,
           Array<double> correlation, Array<double> spread) {
  const size_t n = radius.size();
  if (grids.ndim() != 2 || grids.shape(0) != 3 || grids.shape(1) % LANES)
    throw nb::value_error("grids are not (3, multiple of 16)");
  require_shape("limits", limits, {3});
  require_shape("prior", prior, {SHAPES});
  require_shape("at", at, {n, 2});
  require_shape("radius", radius, {n});
  require_shape("reach", reach, {n});
  require_shape("maps", maps, {n, 2, 3});
  require_shape("correlation", correlation, {n});
  require_shape("spread", spread, {n, 2, 2});
  const Task task = {pyramid(home_levels, home_layout),
                     pyramid(now_levels, now_layout),
                     grids.data(),
                     static_cast<long>(n),
                     static_cast<long>(grids.shape(1)) / LANES,
                     steps,
                     limits.data()[0],
                     limits.data()[1],
                     limits.data()[2],
                     prior.data(),
                     at.data(),
                     radius.data(),
                     reach.data(),
                     maps.data(),
                     correlation.data(),
                     spread.data()};
  bool is_solved;
  {
    nb::gil_scoped_release release;
    is_solved = run(task);
  }
  if (!is_solved) throw nb::value_error("patches without information");
}

}  // namespace
}  // namespace homeward

void bind_align(nanobind::module_ &m) {
  using namespace nanobind::literals;
  m.def("align", &homeward::align, "home_levels"_a.noconvert(), "home_layout"_a.noconvert(),
        "now_levels"_a.noconvert(), "now_layout"_a.noconvert(), "grids"_a.noconvert(),
        "limits"_a.noconvert(), "prior"_a.noconvert(), "steps"_a, "at"_a.noconvert(),
        "radius"_a.noconvert(), "reach"_a.noconvert(), "maps"_a.noconvert(),
        "correlation"_a.noconvert(), "spread"_a.noconvert(),
        "Align patches of home with the panorama now: `maps` begin at the start and end at the "
        "best match.");
}

// Epipolar residuals of matches for given motions, and motions fitted to matches: as in
// vision/geometry/epipolar.py and refinement.py.
#include <cmath>
#include <cstdint>
#include <cstring>
#include <utility>

#include "common.h"

namespace homeward {
namespace {

constexpr int UNKNOWNS = 5;  // theta, alpha, roll, pitch, rise
constexpr int WIDTH = 8;     // matches computed together
enum Column {                // columns of a table of matches, as in `Pairs`
  HOME = 0,
  NOW = 5,
  NOW_TANGENTS = 8,
  SPREAD = 16,  // variance of the azimuth now, covariance, variance of the elevation
  LARGEST_SIGMA = 19,
  GROWTH,
  COLUMNS
};

// One number of each of several matches.
typedef double V __attribute__((vector_size(8 * WIDTH)));
typedef int64_t Mask __attribute__((vector_size(8 * WIDTH)));

// Direction of a motion with its derivatives, and cosines and sines of its angles.
struct Pose {
  double t[3], t_theta[3], t_rise[3];
  double ca, sa, cr, sr, cp, sp;
};

// Residuals of matches in standard deviations, their derivatives, and whether the matches are
// possible.
struct Rows {
  V value, jacobian[UNKNOWNS];
  Mask possible;
};

// Limits of epipolar.py: error of an inlier, cosine of the parallax, error of the growth.
struct Limits {
  double inlier, parallax, growth;
};

Pose pose_of(const double *x) {
  const double c = std::cos(x[0]), s = std::sin(x[0]), cr = std::cos(x[4]), sr = std::sin(x[4]);
  return {{c * cr, s * cr, sr},
          {-s * cr, c * cr, 0.0},
          {-c * sr, -s * sr, cr},
          std::cos(x[1]),
          std::sin(x[1]),
          std::cos(x[2]),
          std::sin(x[2]),
          std::cos(x[3]),
          std::sin(x[3])};
}

V all(double x) { return V{} + x; }

V choose(Mask which, V yes, V no) { return (V)((which & (Mask)yes) | (~which & (Mask)no)); }

V at_least(V x, double low) { return choose(x > all(low), x, all(low)); }

V root(V x) {
  for (int l = 0; l < WIDTH; l++) x[l] = std::sqrt(x[l]);
  return x;
}

V inner(const V *a, const V *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

V inner(const V *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

void cross(const V *a, const V *b, V *product) {
  product[0] = a[1] * b[2] - a[2] * b[1];
  product[1] = a[2] * b[0] - a[0] * b[2];
  product[2] = a[0] * b[1] - a[1] * b[0];
}

void rotate_about_z(double c, double s, const V *x, V *rotated) {
  rotated[0] = c * x[0] - s * x[1];
  rotated[1] = s * x[0] + c * x[1];
  rotated[2] = x[2];
}

// Whether two rays can show the same point.
Mask possible(const V *t, const V *x1, const V *y, const V *normal, V growth, V sigma,
              const Limits &limits) {
  const V *rays[2] = {y, x1};
  V far[2], doubt = {};
  Mask good = inner(x1, y) > all(limits.parallax);
  for (int i = 0; i < 2; i++) {
    V arm[3];
    cross(t, rays[i], arm);
    const V distance = inner(arm, normal);
    const V error = limits.inlier * sigma * root(inner(arm, arm));
    good &= distance >= -error;
    far[i] = at_least(distance, 1e-12);
    doubt += error / far[i];
  }
  const V ratio = far[0] / far[1], most = limits.growth + doubt;
  for (int l = 0; l < WIDTH; l++)
    if (good[l] && !(std::fabs(std::log(ratio[l]) - growth[l]) <= most[l])) good[l] = 0;
  return good;
}

// Rows of some matches; `table` is (COLUMNS, n).
Rows rows_of(const Pose &p, long n, const double *table, double looseness, const Limits &limits) {
  V row[COLUMNS];
  for (int q = 0; q < COLUMNS; q++) std::memcpy(row + q, table + q * n, sizeof row[q]);
  const V *x1 = row + HOME, *x2 = row + NOW;
  const V rolled_y = p.cr * x2[1] - p.sr * x2[2], rolled_z = p.sr * x2[1] + p.cr * x2[2];
  const V leaned[3] = {p.cp * x2[0] + p.sp * rolled_z, rolled_y, p.cp * rolled_z - p.sp * x2[0]};
  const V by_roll[3] = {p.sp * rolled_y, -rolled_z, p.cp * rolled_y};
  const V by_pitch[3] = {leaned[2], V{}, -leaned[0]};
  const V t[3] = {all(p.t[0]), all(p.t[1]), all(p.t[2])};
  V y[3], y_roll[3], y_pitch[3], normal[3], lever[3], gradient[3];
  rotate_about_z(p.ca, p.sa, leaned, y);
  rotate_about_z(p.ca, p.sa, by_roll, y_roll);
  rotate_about_z(p.ca, p.sa, by_pitch, y_pitch);
  cross(x1, y, normal);
  cross(t, x1, lever);
  rotate_about_z(p.ca, -p.sa, lever, gradient);
  const V *spread = row + SPREAD;
  const double loose = looseness * looseness;
  const V across = inner(gradient, row + NOW_TANGENTS);
  const V up = inner(gradient, row + NOW_TANGENTS + 3);
  const V variance = (spread[0] + loose) * across * across + 2.0 * spread[1] * across * up +
                     (spread[2] + loose) * up * up;
  const V by = 1.0 / root(at_least(variance, 1e-18));
  const V sigma = root(row[LARGEST_SIGMA] * row[LARGEST_SIGMA] + loose);
  return {inner(normal, p.t) * by,
          {inner(normal, p.t_theta) * by, (lever[1] * y[0] - lever[0] * y[1]) * by,
           inner(lever, y_roll) * by, inner(lever, y_pitch) * by, inner(normal, p.t_rise) * by},
          possible(t, x1, y, normal, row[GROWTH], sigma, limits)};
}

// Residuals (m, n), Jacobians (UNKNOWNS, m, n) and possible matches of m motions.
void write_residuals(long m, long n, const double *motions, const double *table, double looseness,
                     const Limits &limits, double *value, double *jacobian, bool *possible) {
  for (long i = 0; i < m; i++) {
    const Pose p = pose_of(motions + UNKNOWNS * i);
    for (long k = 0; k < n; k += WIDTH) {
      const Rows rows = rows_of(p, n, table + k, looseness, limits);
      std::memcpy(value + i * n + k, &rows.value, sizeof rows.value);
      for (int q = 0; q < UNKNOWNS; q++)
        std::memcpy(jacobian + (q * m + i) * n + k, rows.jacobian + q, sizeof rows.value);
      for (int l = 0; l < WIDTH; l++) possible[i * n + k + l] = rows.possible[l] != 0;
    }
  }
}

// Solve a system with pivots, in place of the right side; return false if it is singular.
bool eliminate(double (*a)[UNKNOWNS], double *b) {
  for (int i = 0; i < UNKNOWNS; i++) {
    int best = i;
    for (int q = i + 1; q < UNKNOWNS; q++)
      if (std::fabs(a[q][i]) > std::fabs(a[best][i])) best = q;
    if (!(std::fabs(a[best][i]) > 0.0)) return false;
    for (int k = 0; k < UNKNOWNS; k++) std::swap(a[i][k], a[best][k]);
    std::swap(b[i], b[best]);
    for (int q = i + 1; q < UNKNOWNS; q++) {
      const double times = a[q][i] / a[i][i];
      for (int k = i; k < UNKNOWNS; k++) a[q][k] -= times * a[i][k];
      b[q] -= times * b[i];
    }
  }
  for (int i = UNKNOWNS - 1; i >= 0; i--) {
    for (int k = i + 1; k < UNKNOWNS; k++) b[i] -= a[i][k] * b[k];
    b[i] /= a[i][i];
  }
  return true;
}

double sum(V x) {
  double total = 0.0;
  for (int l = 0; l < WIDTH; l++) total += x[l];
  return total;
}

// Normal equations of a step, without the prior.
void write_equations(const Pose &p, long n, const double *table, const double *counts,
                     double looseness, double scale, const Limits &limits,
                     double (*normal)[UNKNOWNS], double *right) {
  V squares[UNKNOWNS][UNKNOWNS] = {}, sums[UNKNOWNS] = {};
  for (long k = 0; k < n; k += WIDTH) {
    V counted;
    std::memcpy(&counted, counts + k, sizeof counted);
    const Rows rows = rows_of(p, n, table + k, looseness, limits);
    const V near = 1.0 + rows.value * rows.value / (scale * scale);
    const Mask used = rows.possible & (counted != V{});
    const V weight = choose(used, counted / (near * near), V{});
    for (int q = 0; q < UNKNOWNS; q++) {
      const V weighted = weight * rows.jacobian[q];
      for (int l = 0; l <= q; l++) squares[q][l] += weighted * rows.jacobian[l];
      sums[q] += weighted * rows.value;
    }
  }
  for (int q = 0; q < UNKNOWNS; q++) {
    for (int l = 0; l <= q; l++) normal[q][l] = normal[l][q] = sum(squares[q][l]);
    right[q] = sum(sums[q]);
  }
}

// Fit m motions in place; return false if a system is singular.
bool fit(long m, long n, long steps, double *motions, const double *table, const double *counts,
         const double *looseness, const double *prior, double scale, double max_step,
         const Limits &limits) {
  for (long i = 0; i < m; i++) {
    double *x = motions + UNKNOWNS * i;
    for (long k = 0; k < steps; k++) {
      double normal[UNKNOWNS][UNKNOWNS], step[UNKNOWNS];
      write_equations(pose_of(x), n, table, counts + i * n, looseness[k], scale, limits, normal,
                      step);
      for (int q = 0; q < UNKNOWNS; q++) {
        step[q] += prior[q] * x[q];
        normal[q][q] += prior[q] + 1e-9;
      }
      if (!eliminate(normal, step)) return false;
      for (int q = 0; q < UNKNOWNS; q++) x[q] -= clipped(step[q], -max_step, max_step);
    }
  }
  return true;
}

Limits limits_of(const Array<const double> &limits) {
  require_shape("limits", limits, {3});
  return {limits.data()[0], limits.data()[1], limits.data()[2]};
}

// Number of matches in a table of them, (COLUMNS, n).
size_t matches(const Array<const double> &table) {
  if (table.ndim() != 2 || table.shape(0) != COLUMNS || table.shape(1) % WIDTH)
    throw nb::value_error("the table of matches is not (21, multiple of 8)");
  return table.shape(1);
}

void residuals(const Array<const double> &motions, const Array<const double> &table,
               double looseness, const Array<const double> &limits, Array<double> value,
               Array<double> jacobian, Array<bool> possible) {
  const size_t m = motions.shape(0), n = matches(table);
  require_shape("motions", motions, {m, UNKNOWNS});
  require_shape("value", value, {m, n});
  require_shape("jacobian", jacobian, {UNKNOWNS, m, n});
  require_shape("possible", possible, {m, n});
  const Limits given = limits_of(limits);
  nb::gil_scoped_release release;
  write_residuals(static_cast<long>(m), static_cast<long>(n), motions.data(), table.data(),
                  looseness, given, value.data(), jacobian.data(), possible.data());
}

bool irls(Array<double> motions, const Array<const double> &table,
          const Array<const double> &counts, const Array<const double> &looseness,
          const Array<const double> &prior, double scale, double max_step,
          const Array<const double> &limits) {
  const size_t m = motions.shape(0), n = matches(table), steps = looseness.shape(0);
  require_shape("motions", motions, {m, UNKNOWNS});
  require_shape("counts", counts, {m, n});
  require_shape("looseness", looseness, {steps});
  require_shape("prior", prior, {UNKNOWNS});
  const Limits given = limits_of(limits);
  nb::gil_scoped_release release;
  return fit(static_cast<long>(m), static_cast<long>(n), static_cast<long>(steps), motions.data(),
             table.data(), counts.data(), looseness.data(), prior.data(), scale, max_step, given);
}

}  // namespace
}  // namespace homeward

void bind_refine(nanobind::module_ &m) {
  using namespace nanobind::literals;
  m.def("residuals", &homeward::residuals, "motions"_a.noconvert(), "table"_a.noconvert(),
        "looseness"_a, "limits"_a.noconvert(), "value"_a.noconvert(), "jacobian"_a.noconvert(),
        "possible"_a.noconvert(),
        "Write residuals (m, n), their derivatives (5, m, n) and which matches are possible.");
  m.def("irls", &homeward::irls, "motions"_a.noconvert(), "table"_a.noconvert(),
        "counts"_a.noconvert(), "looseness"_a.noconvert(), "prior"_a.noconvert(), "scale"_a,
        "max_step"_a, "limits"_a.noconvert(),
        "Fit motions (m, 5) to matches that count for `counts` (m, n), in place, by as many steps "
        "as there are values of `looseness`; return False if a system is singular: the motions "
        "are of no use then.");
}

// Matrices of the localiser's kernels, and arrays that NumPy gets.
#pragma once

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <stdexcept>
#include <vector>

#include "common.h"

namespace homeward {

using In = Array<const double>;
using Out = Array<double>;
using Numbers = Array<const int64_t>;
using Flags = Array<const bool>;

using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using Vector = Eigen::VectorXd;
using Indices = std::vector<Eigen::Index>;
template <int rows, int columns>
using Fixed = Eigen::Matrix<double, rows, columns, columns == 1 ? Eigen::ColMajor : Eigen::RowMajor>;
using Vector3 = Fixed<3, 1>;
using Matrix3 = Fixed<3, 3>;

constexpr int NC = 10;        // unknowns of the calibration, in the order of localizer/motions.py
constexpr int HEAD = 3 + NC;  // the newest pose, and the calibration
enum Calibration { TURN_SCALE, TURN_BIAS, TURN_SLIP, DELAY, TIME_CONSTANT, SPEED_SCALE, SIDEWAYS_SCALE, CAMERA_YAW, CAMERA_X, CAMERA_Y };
using Jacobian = Fixed<3, NC>;

// geometry/se2.py and geometry/angles.py
constexpr double MIN_SQUARED_DISTANCE = 1e-6, TURN = 6.283185307179586;
inline double wrap(double x) { return x - TURN * std::ceil((x - 0.5 * TURN) / TURN); }

inline double median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  return 0.5 * (values[(values.size() - 1) / 2] + values[values.size() / 2]);
}

// A pose b in the frame of a, in the parent frame of a, and its Jacobians by both: geometry/se2.py.
struct Composition {
  Composition(const Vector3 &a, const Vector3 &b) {
    const double c = std::cos(a[2]), s = std::sin(a[2]);
    pose << a[0] + c * b[0] - s * b[1], a[1] + s * b[0] + c * b[1], a[2] + b[2];
    by_a(0, 2) = a[1] - pose[1], by_a(1, 2) = pose[0] - a[0];
    by_b(0, 0) = by_b(1, 1) = c, by_b(0, 1) = -s, by_b(1, 0) = s;
  }
  Vector3 pose;
  Matrix3 by_a = Matrix3::Identity(), by_b = Matrix3::Identity();
};

// A new NumPy array of a shape, with the numbers of a matrix.
template <class M>
nb::ndarray<nb::numpy, double> array_of(const M &matrix, std::initializer_list<size_t> shape) {
  double *data = new double[matrix.size()];
  Eigen::Map<Matrix>(data, matrix.rows(), matrix.cols()) = matrix;
  nb::capsule owner(data, [](void *p) noexcept { delete[] static_cast<double *>(p); });
  return nb::ndarray<nb::numpy, double>(data, shape.size(), shape.begin(), owner);
}

}  // namespace homeward

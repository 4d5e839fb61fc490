// Matrices of the localiser's kernels, and arrays that NumPy gets.
#pragma once

#include <Eigen/Dense>
#include <cmath>
#include <initializer_list>
#include <stdexcept>

#include "common.h"

namespace homeward {

using In = Array<const double>;
using Out = Array<double>;
using Numbers = Array<const int64_t>;

using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using Vector = Eigen::VectorXd;
template <int rows, int columns>
using Fixed = Eigen::Matrix<double, rows, columns, columns == 1 ? Eigen::ColMajor : Eigen::RowMajor>;
using Vector3 = Fixed<3, 1>;
using Matrix3 = Fixed<3, 3>;

constexpr int NC = 9;         // unknowns of the calibration, in the order of localizer/motions.py
constexpr int HEAD = 3 + NC;  // the newest pose, and the calibration
enum Calibration { TURN_SCALE, TURN_BIAS, TURN_SLIP, DELAY, TIME_CONSTANT, SPEED_SCALE };
using Jacobian = Fixed<3, NC>;

// A new NumPy array of a shape, with the numbers of a matrix.
template <class M>
nb::ndarray<nb::numpy, double> array_of(const M &matrix, std::initializer_list<size_t> shape) {
  double *data = new double[matrix.size()];
  Eigen::Map<Matrix>(data, matrix.rows(), matrix.cols()) = matrix;
  nb::capsule owner(data, [](void *p) noexcept { delete[] static_cast<double *>(p); });
  return nb::ndarray<nb::numpy, double>(data, shape.size(), shape.begin(), owner);
}

}  // namespace homeward

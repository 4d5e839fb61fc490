// Normal equations of the window, and their factors: the text to read is reference/factors.py.
#pragma once

#include <vector>

#include "algebra.h"

namespace homeward {

constexpr int STEP = 13 + 3 * NC;

// Normal equations as NumPy holds them; everything is added in place.
struct Equations {
  Equations(size_t w, size_t a) : w(w), a(a) {}
  Equations(Out own, Out next, Out shared, Out common, Out slope, Out common_slope)
      : w(own.size() / 9), a(common.shape(0)), own(own.data()), next(next.data()), shared(shared.data()),
        common(common.data()), slope(slope.data()), common_slope(common_slope.data()) {
    require_shape("own", own, {w, 3, 3});
    if (w < 1) throw nb::value_error("own is empty");
    require_shape("next", next, {w - 1, 3, 3}), require_shape("shared", shared, {w, 3, a});
    require_shape("common", common, {a, a}), require_shape("slope", slope, {w, 3}), require_shape("common_slope", common_slope, {a});
  }
  Eigen::Map<Matrix3> own_of(size_t k) const { return Eigen::Map<Matrix3>(own + 9 * k); }
  Eigen::Map<Matrix3> next_of(size_t k) const { return Eigen::Map<Matrix3>(next + 9 * k); }
  Eigen::Map<Matrix> shared_of(size_t k) const { return Eigen::Map<Matrix>(shared + 3 * a * k, 3, a); }
  Eigen::Map<Vector3> slope_of(size_t k) const { return Eigen::Map<Vector3>(slope + 3 * k); }
  Eigen::Map<Matrix> common_all() const { return Eigen::Map<Matrix>(common, a, a); }
  Eigen::Map<Vector> common_slope_all() const { return Eigen::Map<Vector>(common_slope, a); }
  size_t w, a;  // numbers of poses and of shared unknowns
  double *own, *next, *shared, *common, *slope, *common_slope;
};

// Normal equations with memory of their own, of zeros.
struct OwnEquations : Equations {
  OwnEquations(size_t w, size_t a);
  void clear();
  nb::tuple arrays() const;  // as NumPy's, in the order of NormalEquations

 private:
  size_t size_;
  nb::capsule owner_;
};

// Bearings as in SightedFrom, after their shapes have been tested.
struct Bearings {
  const double *bearings, *sigmas, *effective;
  const int64_t *frames, *landmarks, *poses;
  const double *free, *jacobians;
  size_t m, f;
};

// Where the rows of factors are written to; null: nowhere. As in WeighedSightings and OdometryErrors.
struct Linearised {
  double *residual = nullptr, *by_bearing = nullptr, *error = nullptr, *by_motion = nullptr, *weight = nullptr;
};

void add_odometry(const Equations &e, const double *poses, const double *calibration, const double *steps,
                  const Linearised &rows);
void add_bearings(const Equations &e, const Bearings &seen, const double *poses, const double *unknowns, double gate,
                  const Linearised &rows);

struct Step {
  Matrix poses;  // (w, 3)
  Vector shared;
};

// Consecutive poses, eliminated. Their tail are the unknowns with which they are coupled: the poses before and after
// them, and some of the shared unknowns.
struct Chain {
  Chain() = default;
  Chain(const Equations &e, size_t begin, size_t end, const Indices &shared);
  // Subtract their Schur complement from equations without them, of which the pose before them is the i-th.
  void subtract_from(const Equations &e, size_t i) const;
  void whiten(Eigen::Ref<Matrix> gradients) const;  // their own rows of gradients or steps, as Elimination
  void substitute(Eigen::Ref<Matrix> steps) const;
  size_t begin = 0;
  Indices tail;  // among all unknowns
  Matrix rows;   // the inverse of their factor times their blocks with the tail

 private:
  std::vector<Matrix3> factors_, following_;
};

// Normal equations with all poses but the newest eliminated: reference.window.Elimination. In a long window, each pose
// saw few of the landmarks. So segments are eliminated first, each with the landmarks that it saw; then the poses
// between them, which have all landmarks from then on. The oldest pose, which has them by the prior, is one of these.
struct Elimination {
  explicit Elimination(const Equations &e);
  Step solve() const;
  Matrix covariance() const;  // of the newest pose and the shared unknowns
  // Divide other gradients, in columns, of poses (3 w) and shared unknowns (a) by the factor of the Hessian: the
  // products of two columns are then those of one with the steps for the other.
  void whiten(Matrix &gradients) const;
  // From whitened gradients to steps: of newest pose and shared unknowns, or of `all`.
  void substitute(Matrix &steps, bool all) const;
  Matrix whitened;  // own gradient, a column

 private:
  static constexpr size_t SEGMENT = 24;  // poses from one that is kept to the next; in short windows all are kept
  size_t n_;  // number of unknowns: of the newest pose and shared ones
  std::vector<Chain> segments_;
  Indices rest_;  // where the others are among all unknowns
  Chain chain_;
  Eigen::LLT<Eigen::MatrixXd> factor_;
};

}  // namespace homeward

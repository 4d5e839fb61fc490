// The window, solved by Gauss-Newton: the text to read is reference/window.py.
#include <algorithm>
#include <limits>
#include <vector>

#include "equations.h"

namespace homeward {
Elimination::Elimination(const Equations &e)
    : older_(3 * (e.w - 1)), n_(3 + e.a), rows_(Matrix::Zero(older_, n_ + 1)), factors_(e.w - 1), following_(e.w - 1) {
  const size_t w = e.w, a = e.a;
  Matrix information(n_, n_);
  information.topLeftCorner(3, 3) = e.own_of(w - 1);
  information.topRightCorner(3, a) = e.shared_of(w - 1);
  information.bottomLeftCorner(a, 3) = information.topRightCorner(3, a).transpose();
  information.bottomRightCorner(a, a) = e.common_all();
  Vector gradient(n_);
  gradient << e.slope_of(w - 1), e.common_slope_all();
  // Of each eliminated pose: the inverse of its factor times its blocks with the newest pose and the shared
  // unknowns (n), and its gradient (1). All rows together have one product at the end.
  Matrix3 block = e.own_of(0);
  for (size_t k = 0; k + 1 < w; k++) {
    const Eigen::LLT<Eigen::Matrix3d> llt{Eigen::Matrix3d(block)};
    if (llt.info() != Eigen::Success) throw std::domain_error("a pose is not determined");
    auto row = rows_.middleRows<3>(3 * k);
    row.block(0, 3, 3, a) += e.shared_of(k);
    row.col(n_) += e.slope_of(k);
    const Eigen::Matrix3d lower = llt.matrixL(), coupling = e.next_of(k);
    factors_[k] = lower;
    following_[k] = lower.triangularView<Eigen::Lower>().solve(coupling);
    const bool last = k + 2 == w;
    if (last) row.leftCols(3) = coupling;
    factors_[k].triangularView<Eigen::Lower>().solveInPlace(row);
    if (last) break;
    block = e.own_of(k + 1) - following_[k].transpose() * following_[k];
    rows_.middleRows<3>(3 * (k + 1)).noalias() -= following_[k].transpose().lazyProduct(row);
  }
  if (w > 1) {  // of matrices without rows, Eigen divides by zero
    information.selfadjointView<Eigen::Lower>().rankUpdate(rows_.leftCols(n_).transpose(), -1.0);
    gradient.noalias() -= rows_.leftCols(n_).transpose() * rows_.col(n_);
  }
  factor_.compute(information);  // only the lower half is used
  if (factor_.info() != Eigen::Success) throw std::domain_error("not positive definite");
  whitened.resize(older_ + n_, 1);
  whitened << rows_.col(n_), factor_.matrixL().solve(gradient);
}

void Elimination::whiten(Matrix &gradients) const {
  for (size_t k = 0; k < older_; k += 3) {
    auto row = gradients.middleRows<3>(k);
    factors_[k / 3].triangularView<Eigen::Lower>().solveInPlace(row);
    if (k + 3 < older_) gradients.middleRows<3>(k + 3).noalias() -= following_[k / 3].transpose().lazyProduct(row);
  }
  Eigen::MatrixXd tail = gradients.bottomRows(n_);
  if (older_) tail.noalias() -= rows_.leftCols(n_).transpose() * gradients.topRows(older_);
  factor_.matrixL().solveInPlace(tail);
  gradients.bottomRows(n_) = tail;
}

void Elimination::substitute(Matrix &steps, bool all) const {
  Eigen::MatrixXd tail = steps.bottomRows(n_);
  factor_.matrixU().solveInPlace(tail);
  steps.bottomRows(n_) = tail;
  if (!all || !older_) return;
  steps.topRows(older_).noalias() -= rows_.leftCols(n_) * tail;
  for (size_t k = older_; k > 0;) {
    k -= 3;
    auto row = steps.middleRows<3>(k);
    if (k + 3 < older_) row.noalias() -= following_[k / 3].lazyProduct(steps.middleRows<3>(k + 3));
    factors_[k / 3].transpose().triangularView<Eigen::Upper>().solveInPlace(row);
  }
}

Step Elimination::solve() const {
  Matrix steps = whitened;
  substitute(steps, true);
  return {Eigen::Map<Matrix>(steps.data(), older_ / 3 + 1, 3), steps.bottomRows(n_ - 3)};
}

Matrix Elimination::covariance() const {
  Eigen::MatrixXd inverse = Eigen::MatrixXd::Identity(n_, n_);
  factor_.matrixL().solveInPlace(inverse);
  Eigen::MatrixXd found = Eigen::MatrixXd::Zero(n_, n_);
  found.selfadjointView<Eigen::Lower>().rankUpdate(inverse.transpose());
  found.triangularView<Eigen::StrictlyUpper>() = found.transpose();
  return found;
}

namespace {

// Constants of localizer/tunables.py.
struct WindowTunables {
  double gate, linear, close, converged, negligible, rounding, min_distance;
  int max_steps;
};

// reference.window.Window: the arrays, which must not change meanwhile, and the estimate of the unknowns.
class Window {
 public:
  Window(In poses, In shared, In steps, In bearings, In sigmas, In effective, Numbers frames, Numbers landmarks,
         Numbers poses_of, In free, In jacobians, In information, In gradient, In at, In weights, In means,
         Flags one_sided, Flags bounded, const WindowTunables &tunables)
      : w(poses.shape(0)), a(shared.size()), steps_(steps), bearings_(bearings), sigmas_(sigmas),
        effective_(effective), frames_(frames), landmarks_(landmarks), poses_of_(poses_of), free_(free),
        jacobians_(jacobians), information_(information), gradient_(gradient), at_(at), weights_(weights),
        means_(means), one_sided_(one_sided), tunables_(tunables) {
    const size_t m = bearings.size(), f = poses_of.size();
    if (w < 1 || a < NC || (a - NC) % 2) throw nb::value_error("poses or shared has another shape");
    require_shape("poses", poses, {w, 3}), require_shape("shared", shared, {a});
    require_shape("steps", steps, {w - 1, STEP}), require_shape("bearings", bearings, {m});
    require_shape("sigmas", sigmas, {m}), require_shape("effective", effective, {m});
    require_shape("frame", frames, {m}), require_shape("landmark", landmarks, {m});
    require_shape("pose", poses_of, {f}), require_shape("free", free, {f, 3});
    require_shape("jacobians", jacobians, {f, 3, NC}), require_shape("information", information, {3 + a, 3 + a});
    require_shape("gradient", gradient, {3 + a}), require_shape("at", at, {3 + a});
    require_shape("weights", weights, {NC}), require_shape("means", means, {NC});
    require_shape("is_one_sided", one_sided, {NC}), require_shape("is_bounded", bounded, {NC});
    poses_ = Eigen::Map<const Matrix>(poses.data(), w, 3), shared_ = Eigen::Map<const Vector>(shared.data(), a);
    std::copy_n(bounded.data(), NC, bounded_);
  }

  // reference.window.linearised(), without more factors: the arrays of the normal equations, of bearings (residual,
  // Jacobian), and of motions (error, Jacobian, information, weight).
  nb::tuple linearised() const {
    const size_t m = bearings_.size();
    const OwnEquations e(w, a);
    Vector residual(m), weight(w - 1);
    Matrix by_bearing(m, HEAD + 2), error(w - 1, 3), by_motion(w - 1, 3 * (6 + NC));
    const Linearised rows{residual.data(), by_bearing.data(), error.data(), by_motion.data(), weight.data()};
    add_to(e, rows);
    const Matrix information = Eigen::Map<const Matrix>(steps_.data(), w - 1, STEP).middleCols<9>(3);
    return nb::make_tuple(e.arrays(), array_of(Matrix(residual), {m}), array_of(by_bearing, {m, HEAD + 2}),
                          array_of(error, {w - 1, 3}), array_of(by_motion, {w - 1, 3, 6 + NC}),
                          array_of(information, {w - 1, 3, 3}), array_of(Matrix(weight), {w - 1}));
  }

  // reference.window.solve(). `add_more` takes the arrays of normal equations, poses and shared unknowns; or None.
  nb::tuple solve(nb::object add_more) {
    OwnEquations e(w, a);
    Matrix covariance;
    bool converged = false;
    for (int k = 0; k < tunables_.max_steps && !converged; k++) {
      e.clear();
      add_to(e);
      if (!add_more.is_none()) add_more(e.arrays(), array_of(poses_, {w, 3}), array_of(Matrix(shared_), {a}));
      const Elimination eliminated(e);
      const Step step = eliminated.solve();
      const bool is_small = move(step) < tunables_.converged;
      converged = !bound() && is_small;
      if (!step.poses.allFinite() || !step.shared.allFinite()) throw std::domain_error("a step is not finite");
      if (converged || k + 1 == tunables_.max_steps) covariance = eliminated.covariance();
    }
    if (!covariance.allFinite()) throw std::domain_error("a step is not finite");
    if (!(covariance.diagonal().array() > 0.0).all()) throw std::domain_error("a variance is not positive");
    Fixed<1, NC> bounded;
    for (int k = 0; k < NC; k++) bounded[k] = bounded_[k];
    return nb::make_tuple(array_of(poses_, {w, 3}), array_of(Matrix(shared_), {a}),
                          array_of(covariance, {3 + a, 3 + a}), array_of(bounded, {size_t(NC)}), converged);
  }

 private:
  void add_to(const Equations &e, const Linearised &rows = {}) const {
    const Eigen::Map<const Matrix> information(information_.data(), 3 + a, 3 + a);
    Vector off(3 + a);
    off << poses_.row(0).transpose(), shared_;
    off -= Eigen::Map<const Vector>(at_.data(), 3 + a);
    const Vector downhill = Eigen::Map<const Vector>(gradient_.data(), 3 + a) - information * off;
    e.own_of(0) += information.topLeftCorner<3, 3>();
    e.shared_of(0) += information.topRightCorner(3, a);
    e.common_all() += information.bottomRightCorner(a, a);
    e.slope_of(0) += downhill.head<3>();
    e.common_slope_all() += downhill.tail(a);
    add_odometry(e, poses_.data(), shared_.data(), steps_.data(), rows);
    const Bearings seen{bearings_.data(), sigmas_.data(), effective_.data(), frames_.data(), landmarks_.data(),
                        poses_of_.data(), free_.data(), jacobians_.data(), bearings_.size(), poses_of_.size()};
    add_bearings(e, seen, poses_.data(), shared_.data(), tunables_.gate, rows);
    const double kept = 1.0 / (tunables_.negligible * tunables_.negligible);
    for (int k = 0; k < NC; k++) {
      const double weight = weights_.data()[k] + (bounded_[k] ? kept : 0.0);
      e.common[a * k + k] += weight;
      e.common_slope[k] -= weights_.data()[k] * (shared_[k] - means_.data()[k]) + (bounded_[k] ? kept * shared_[k] : 0.0);
    }
  }

  // Apply a step, limited to the linear range; return its full size.
  double move(const Step &step) {
    const size_t n = (a - NC) / 2;
    std::vector<double> distances(n), apart(n);
    for (size_t k = 0; k < n; k++) {
      distances[k] = std::hypot(shared_[NC + 2 * k] - poses_(w - 1, 0), shared_[NC + 2 * k + 1] - poses_(w - 1, 1));
      apart[k] = std::hypot(step.shared[NC + 2 * k], step.shared[NC + 2 * k + 1]);
    }
    const double scale = n ? std::max(median(distances), tunables_.min_distance) : std::numeric_limits<double>::infinity();
    double share = 0.0;
    for (size_t k = 0; k < n; k++) share = std::max(share, apart[k] / (distances[k] + tunables_.close * scale));
    const double turn = step.poses.col(2).cwiseAbs().maxCoeff();
    const double shift = std::max(step.poses.leftCols(2).cwiseAbs().maxCoeff(),
                                  step.shared.segment<2>(CAMERA_X).cwiseAbs().maxCoeff());
    const double limited = 1.0 / std::max(1.0, std::max(turn, share) / tunables_.linear);
    poses_ += limited * step.poses, shared_ += limited * step.shared;
    return std::max(std::max(turn, share), std::max(shift / scale, step.shared.head(CAMERA_X).cwiseAbs().maxCoeff()));
  }

  // Update which unknowns are kept at zero; return whether any changed.
  bool bound() {
    bool changed = false;
    for (int k = 0; k < NC; k++) {
      const double limit = bounded_[k] ? -tunables_.rounding : -tunables_.negligible;
      const bool now = one_sided_.data()[k] && shared_[k] < limit;
      changed |= now != bounded_[k], bounded_[k] = now;
    }
    return changed;
  }

  const size_t w, a;
  Matrix poses_;
  Vector shared_;
  bool bounded_[NC];
  const In steps_, bearings_, sigmas_, effective_;
  const Numbers frames_, landmarks_, poses_of_;
  const In free_, jacobians_, information_, gradient_, at_, weights_, means_;
  const Flags one_sided_;
  const WindowTunables tunables_;
};

// Elimination.solve() of reference/window.py, of normal equations.
nb::tuple solve_equations(Out own, Out next, Out shared, Out common, Out slope, Out common_slope) {
  const Equations e(own, next, shared, common, slope, common_slope);
  const Elimination eliminated(e);
  const Step step = eliminated.solve();
  return nb::make_tuple(array_of(step.poses, {e.w, 3}), array_of(Matrix(step.shared), {e.a}),
                        array_of(eliminated.covariance(), {3 + e.a, 3 + e.a}));
}

// Arrays are taken as they are: a copy of one with another layout would be written to in vain.
auto array(const char *name) { return nb::arg(name).noconvert(); }

}  // namespace

}  // namespace homeward

void bind_window(nanobind::module_ &m) {
  using namespace homeward;
  nb::class_<WindowTunables>(m, "WindowTunables")
      .def(nb::init<double, double, double, double, double, double, double, int>(), nb::arg("gate"), nb::arg("linear"),
           nb::arg("close"), nb::arg("converged"), nb::arg("negligible"), nb::arg("rounding"), nb::arg("min_distance"),
           nb::arg("max_steps"));
  nb::class_<Window>(m, "Window")
      .def(nb::init<In, In, In, In, In, In, Numbers, Numbers, Numbers, In, In, In, In, In, In, In, Flags, Flags,
                    const WindowTunables &>(),
           array("poses"), array("shared"), array("steps"), array("bearings"), array("sigmas"), array("effective"),
           array("frame"), array("landmark"), array("pose"), array("free"), array("jacobians"), array("information"),
           array("gradient"), array("at"), array("weights"), array("means"), array("is_one_sided"),
           array("is_bounded"), nb::arg("tunables"))
      .def("linearised", &Window::linearised)
      .def("solve", &Window::solve, nb::arg("add_more").none());
  m.def("solve_equations", &solve_equations, array("own"), array("next"), array("shared"), array("common"),
        array("slope"), array("common_slope"));
}

// The window, solved by Gauss-Newton: the text to read is reference/window.py.
#include <algorithm>
#include <limits>
#include <numeric>
#include <vector>

#include "equations.h"

namespace homeward {
Chain::Chain(const Equations &e, size_t begin, size_t end, const Indices &shared)
    : begin(begin), factors_(end - begin), following_(end - begin) {
  for (size_t at = begin ? 3 * (begin - 1) : 0; at < 3 * (end + 1); at++)
    if (at < 3 * begin || at >= 3 * end) tail.push_back(at);
  const size_t head = tail.size(), n = head + shared.size();
  for (Eigen::Index at : shared) tail.push_back(3 * e.w + at);
  rows = Matrix::Zero(3 * (end - begin), n);
  if (begin == end) return;
  if (begin) rows.topLeftCorner<3, 3>() = e.next_of(begin - 1).transpose();
  rows.block<3, 3>(rows.rows() - 3, head - 3) += e.next_of(end - 1);
  Matrix3 block = e.own_of(begin);
  for (size_t k = begin, i = 0; k < end; k++, i++) {
    const Eigen::LLT<Eigen::Matrix3d> llt{Eigen::Matrix3d(block)};
    if (llt.info() != Eigen::Success) throw std::domain_error("a pose is not determined");
    auto row = rows.middleRows<3>(3 * i);
    const auto all = e.shared_of(k);
    for (size_t c = head; c < n; c++) row.col(c) += all.col(shared[c - head]);
    const Eigen::Matrix3d lower = llt.matrixL(), coupling = e.next_of(k);
    factors_[i] = lower;
    factors_[i].triangularView<Eigen::Lower>().solveInPlace(row);
    if (k + 1 == end) break;
    following_[i] = lower.triangularView<Eigen::Lower>().solve(coupling);
    rows.middleRows<3>(3 * (i + 1)).noalias() -= following_[i].transpose().lazyProduct(row);
    block = e.own_of(k + 1) - following_[i].transpose() * following_[i];
  }
}

void Chain::subtract_from(const Equations &e, size_t i) const {
  const size_t n = rows.cols();
  Matrix taken = Matrix::Zero(n, n);
  taken.selfadjointView<Eigen::Lower>().rankUpdate(rows.transpose(), -1.0);
  e.own_of(i) += taken.block<3, 3>(0, 0), e.own_of(i + 1) += taken.block<3, 3>(3, 3);
  e.next_of(i) += taken.block<3, 3>(3, 0).transpose();
  for (size_t c = 6; c < n; c++) {
    const size_t at = tail[c] - tail[6];  // the calibration is first
    e.shared_of(i).col(at) += taken.block<1, 3>(c, 0).transpose();
    e.shared_of(i + 1).col(at) += taken.block<1, 3>(c, 3).transpose();
    for (size_t d = 6; d <= c; d++) e.common[e.a * at + (tail[d] - tail[6])] += taken(c, d);
  }
}

void Chain::whiten(Eigen::Ref<Matrix> gradients) const {
  for (size_t i = 0; i < factors_.size(); i++) {
    auto row = gradients.middleRows<3>(3 * i);
    factors_[i].triangularView<Eigen::Lower>().solveInPlace(row);
    if (i + 1 < factors_.size())
      gradients.middleRows<3>(3 * (i + 1)).noalias() -= following_[i].transpose().lazyProduct(row);
  }
}

void Chain::substitute(Eigen::Ref<Matrix> steps) const {
  for (size_t i = factors_.size(); i-- > 0;) {
    auto row = steps.middleRows<3>(3 * i);
    if (i + 1 < factors_.size()) row.noalias() -= following_[i].lazyProduct(steps.middleRows<3>(3 * (i + 1)));
    factors_[i].transpose().triangularView<Eigen::Upper>().solveInPlace(row);
  }
}

namespace {

// Shared unknowns with which poses are coupled: the calibration, and the landmarks that they saw.
Indices coupled(const Equations &e, size_t begin, size_t end) {
  Eigen::RowVectorXd sum = Eigen::RowVectorXd::Zero(e.a);
  for (size_t k = begin; k < end; k++) sum += e.shared_of(k).cwiseAbs().colwise().sum();
  Indices found;
  for (size_t at = 0; at < e.a; at++)
    if (at < NC || sum[at] != 0.0) found.push_back(at);
  return found;
}

}  // namespace

Elimination::Elimination(const Equations &e) : n_(3 + e.a) {
  std::vector<size_t> kept;
  for (size_t k = 0; k + 1 < e.w; k += e.w > 2 * SEGMENT ? SEGMENT : 1) kept.push_back(k);
  kept.push_back(e.w - 1);
  const size_t last = kept.size() - 1;
  OwnEquations rest(last + 1, e.a);
  rest.common_all() = e.common_all();
  for (size_t i = 0; i <= last; i++) {
    const size_t k = kept[i];
    for (int c = 0; c < 3; c++) rest_.push_back(3 * k + c);
    rest.own_of(i) += e.own_of(k), rest.shared_of(i) += e.shared_of(k);
    if (i == last) break;
    if (kept[i + 1] == k + 1) {
      rest.next_of(i) = e.next_of(k);
      continue;
    }
    segments_.emplace_back(e, k + 1, kept[i + 1], coupled(e, k + 1, kept[i + 1]));
    segments_.back().subtract_from(rest, i);
  }
  Indices all(e.a);
  std::iota(all.begin(), all.end(), 0);
  for (Eigen::Index at : all) rest_.push_back(3 * e.w + at);
  chain_ = Chain(rest, 0, last, all);
  Matrix information(n_, n_);  // only the lower half is used
  information.topLeftCorner(3, 3) = rest.own_of(last);
  information.bottomLeftCorner(e.a, 3) = rest.shared_of(last).transpose();
  information.bottomRightCorner(e.a, e.a) = rest.common_all();
  // Of matrices without rows, Eigen divides by zero.
  if (last) information.selfadjointView<Eigen::Lower>().rankUpdate(chain_.rows.transpose(), -1.0);
  factor_.compute(information);
  if (factor_.info() != Eigen::Success) throw std::domain_error("not positive definite");
  whitened.resize(3 * e.w + e.a, 1);
  whitened << Eigen::Map<const Vector>(e.slope, 3 * e.w), e.common_slope_all();
  whiten(whitened);
}

void Elimination::whiten(Matrix &gradients) const {
  for (const Chain &segment : segments_) {
    auto own = gradients.middleRows(3 * segment.begin, segment.rows.rows());
    segment.whiten(own);
    gradients(segment.tail, Eigen::all) -= segment.rows.transpose() * own;
  }
  Matrix rest = gradients(rest_, Eigen::all);
  auto older = rest.topRows(chain_.rows.rows());
  chain_.whiten(older);
  Eigen::MatrixXd tail = rest.bottomRows(n_);
  if (older.rows()) tail.noalias() -= chain_.rows.transpose() * older;
  factor_.matrixL().solveInPlace(tail);
  rest.bottomRows(n_) = tail;
  gradients(rest_, Eigen::all) = rest;
}

void Elimination::substitute(Matrix &steps, bool all) const {
  Matrix rest = steps(rest_, Eigen::all);
  auto older = rest.topRows(chain_.rows.rows());
  Eigen::MatrixXd tail = rest.bottomRows(n_);
  factor_.matrixU().solveInPlace(tail);
  rest.bottomRows(n_) = tail;
  if (all && older.rows()) {
    older.noalias() -= chain_.rows * tail;
    chain_.substitute(older);
  }
  steps(rest_, Eigen::all) = rest;
  if (!all) return;
  for (const Chain &segment : segments_) {
    auto own = steps.middleRows(3 * segment.begin, segment.rows.rows());
    own.noalias() -= segment.rows * steps(segment.tail, Eigen::all);
    segment.substitute(own);
  }
}

Step Elimination::solve() const {
  Matrix steps = whitened;
  substitute(steps, true);
  const Eigen::Index a = n_ - 3;
  return {Eigen::Map<Matrix>(steps.data(), (steps.rows() - a) / 3, 3), steps.bottomRows(a)};
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

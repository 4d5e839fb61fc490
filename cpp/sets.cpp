// Sets of home bearings, and labels of items: the text to read is reference/sets.py.
#include <optional>
#include <vector>

#include "labels.h"

namespace homeward {
namespace {

constexpr int HOME = 0, RESIDUAL = 3, POSE = 4, REST = 7;  // columns of a linearisation
constexpr int YAW = 3, PLACES = 4;                         // of the state

// Constants of localizer/tunables.py.
struct SetTunables {
  double max_turn, converged, rounding, min_distance, outlier_sigma, upheaval;
};

// sets.Linear, with its arrays as NumPy has them.
struct Linear {
  Vector3 at;
  Matrix by_place;  // (q, 2)
  Vector by_yaw;
  Matrix cross, columns;
  nb::tuple arrays() const {
    const size_t q = by_place.rows();
    return nb::make_tuple(array_of(at, {3}), array_of(by_place, {q, 2}), array_of(by_yaw, {q}),
                          array_of(cross, {q, 4 + 2 * q}), array_of(columns, {q, REST + q}));
  }
};

// sets.HomeSolution.
struct Solution {
  Vector3 step, pose;
  Matrix3 information, inverse, pose_by_home, pose_covariance, walk_information;
  Matrix weighted, alone;  // (q, 4), (q, 5)
  double log_density;
  nb::tuple arrays() const {
    const size_t q = weighted.rows();
    return nb::make_tuple(array_of(step, {3}), array_of(information, {3, 3}), array_of(inverse, {3, 3}),
                          array_of(weighted, {q, 4}), array_of(alone, {q, 5}), array_of(pose, {3}),
                          array_of(pose_by_home, {3, 3}), array_of(pose_covariance, {3, 3}),
                          array_of(walk_information, {3, 3}), log_density);
  }
};

// sets.HomeArrays: the arrays, which must not change meanwhile.
class Home {
 public:
  Home(In mean, In covariance, In bearings, In sigmas, In mount, In offsets, In prior, In information, In walk_excess,
       Flags members, In one_body, bool same_camera, double moved_prior, double max_step, const SetTunables &tunables)
      : q(bearings.size()), n(PLACES + 2 * q), mean_(mean), covariance_(covariance), bearings_(bearings),
        sigmas_(sigmas), mount_(mount), offsets_(offsets), prior_(prior), information_(information),
        walk_excess_(walk_excess), members_(members), one_body_(one_body), same_camera_(same_camera),
        moved_prior_(moved_prior), max_step_(max_step), tunables_(tunables) {
    require_shape("mean", mean, {n}), require_shape("covariance", covariance, {n, n});
    require_shape("bearings", bearings, {q}), require_shape("sigmas", sigmas, {q}), require_shape("mount", mount, {3});
    if (offsets.is_valid()) require_shape("offsets", offsets, {q, 3});
    if (prior.is_valid()) require_shape("prior", prior, {3});
    require_shape("information", information, {3, 3}), require_shape("walk_excess", walk_excess, {q, 2, 2});
    const size_t b = one_body.size();
    require_shape("members", members, {b, q}), require_shape("one_body", one_body, {b});
  }

  // sets.fit(), or None.
  nb::object fit(In home, Flags inliers, int steps) const {
    require_shape("home", home, {3}), require_shape("inliers", inliers, {q});
    Vector3 at = vector3(home);
    Vector state = mean();
    for (int k = 1;; k++) {
      const Linear linear = linearised(at, state);
      const std::optional<Solution> found = solved(linear, inliers.data());
      if (!found || k >= steps || length(found->step) < tunables_.converged) return both(linear, found);
      at += found->step;
      const Vector correction = found->weighted.col(RESIDUAL) - found->weighted.leftCols(3) * found->step;
      state = mean() + linear.cross.transpose() * correction;
    }
  }

  // sets.propagated(), or None.
  nb::object propagate(In at, In by_place, In by_yaw, In cross, In columns, In mean_before, Flags inliers) const {
    require_shape("mean", mean_before, {n}), require_shape("inliers", inliers, {q});
    Linear linear = linear_of(at, by_place, by_yaw, cross, columns);
    add_by_map(linear, Eigen::Map<const Vector>(mean_before.data(), n) - mean());
    set_covariances(linear);
    return both(linear, solved(linear, inliers.data()));
  }

  // sets.solved(), or None.
  nb::object solve(In at, In by_place, In by_yaw, In cross, In columns, Flags inliers) const {
    require_shape("inliers", inliers, {q});
    const std::optional<Solution> found = solved(linear_of(at, by_place, by_yaw, cross, columns), inliers.data());
    return found ? nb::object(found->arrays()) : nb::none();
  }

  // sets.weighed().
  nb::tuple weigh(In at, Flags inliers, In step, In inverse, In alone, double log_density) const {
    require_shape("at", at, {3}), require_shape("inliers", inliers, {q}), require_shape("step", step, {3});
    require_shape("inverse", inverse, {3, 3}), require_shape("alone", alone, {q, 5});
    const Eigen::Map<const Matrix3> covariance(inverse.data());
    const bool *inside = inliers.data();
    Vector innovation(q), variance(q), odds(q), wrong(q);
    double log_evidence = log_density;
    for (size_t i = 0; i < q; i++) {
      const double *row = alone.data() + 5 * i, own = row[4];
      const Eigen::Map<const Vector3> jacobian(row);
      const double off = row[RESIDUAL] - jacobian.dot(vector3(step)), by_home = jacobian.dot(covariance * jacobian);
      const double given = inside[i] ? 1.0 / std::max((1.0 - by_home / own) / own, 1e-9) : own + by_home;
      variance[i] = std::max(given, sigmas_.data()[i] * sigmas_.data()[i]);
      innovation[i] = inside[i] ? off / own * variance[i] : wrap(off);
      const double pushed = variance[i] + tunables_.outlier_sigma * tunables_.outlier_sigma;
      wrong[i] = log_add(log_inlier(innovation[i], pushed), -LOG_TWO_PI) - std::log(2.0);
      odds[i] = log_inlier(innovation[i], variance[i]) - wrong[i];
      if (!inside[i]) log_evidence += wrong[i];
    }
    const Vector more = log_moved(vector3(at), innovation, variance, wrong);
    const LabelPrior prior(members_, one_body_.data(), Vector::Constant(q, moved_prior_), more.data(), tunables_.upheaval);
    Labels labels = Eigen::Map<const Labels>(inside, q);
    const double log_prior = prior(labels.data());
    for (size_t i = 0; i < q; i++) {
      labels[i] = !labels[i];
      const double gain = prior(labels.data()) - log_prior;
      labels[i] = inside[i], odds[i] += inside[i] ? -gain : gain;
    }
    return nb::make_tuple(array_of(innovation, {q}), array_of(variance, {q}), array_of(odds, {q}), log_evidence + log_prior);
  }

 private:
  static nb::object both(const Linear &linear, const std::optional<Solution> &found) {
    return found ? nb::object(nb::make_tuple(linear.arrays(), found->arrays())) : nb::none();
  }
  static Vector3 vector3(const In &array) { return Eigen::Map<const Vector3>(array.data()); }
  Eigen::Map<const Vector> mean() const { return Eigen::Map<const Vector>(mean_.data(), n); }
  Eigen::Map<const Matrix> covariance() const { return Eigen::Map<const Matrix>(covariance_.data(), n, n); }
  Eigen::Map<const Matrix3> information() const { return Eigen::Map<const Matrix3>(information_.data()); }

  Linear linear_of(const In &at, const In &by_place, const In &by_yaw, const In &cross, const In &columns) const {
    require_shape("at", at, {3}), require_shape("by_place", by_place, {q, 2}), require_shape("by_yaw", by_yaw, {q});
    require_shape("cross_covariance", cross, {q, n}), require_shape("columns", columns, {q, REST + q});
    return {vector3(at), Eigen::Map<const Matrix>(by_place.data(), q, 2), Eigen::Map<const Vector>(by_yaw.data(), q),
            Eigen::Map<const Matrix>(cross.data(), q, n), Eigen::Map<const Matrix>(columns.data(), q, REST + q)};
  }

  // sets.expected() and sets.linearised().
  Linear linearised(const Vector3 &home, const Vector &state) const {
    Linear linear{home, Matrix(q, 2), Vector::Zero(q), Matrix(q, n), Matrix(q, REST + q)};
    Vector3 eye = Composition(home, vector3(mount_)).pose;
    if (same_camera_) eye[2] += state[YAW];
    for (size_t i = 0; i < q; i++) {
      Vector3 own = eye;
      if (offsets_.is_valid()) own = Composition(eye, Eigen::Map<const Vector3>(offsets_.data() + 3 * i)).pose;
      const double dx = state[PLACES + 2 * i] - own[0], dy = state[PLACES + 2 * i + 1] - own[1];
      const double square = std::max(dx * dx + dy * dy, tunables_.min_distance * tunables_.min_distance);
      const double x = -dy / square, y = dx / square;
      linear.by_place(i, 0) = x, linear.by_place(i, 1) = y;
      const double by_heading = x * (own[1] - eye[1]) - y * (own[0] - eye[0]) - 1.0;
      linear.columns.block<1, 3>(i, HOME) << -x, -y, x * (eye[1] - home[1]) - y * (eye[0] - home[0]) + by_heading;
      if (same_camera_) linear.by_yaw[i] = by_heading;
      linear.columns(i, RESIDUAL) = wrap(bearings_.data()[i] - (std::atan2(dy, dx) - own[2]));
    }
    add_by_map(linear, state - mean());
    set_covariances(linear);
    return linear;
  }

  // Add the product of the Jacobian by the state with an offset of the state to the residuals.
  void add_by_map(Linear &linear, const Vector &off) const {
    for (size_t i = 0; i < q; i++)
      linear.columns(i, RESIDUAL) += linear.by_yaw[i] * off[YAW] + linear.by_place.row(i).dot(off.segment<2>(PLACES + 2 * i));
  }

  void set_covariances(Linear &linear) const {
    const Eigen::Map<const Matrix> c = covariance();
    for (size_t i = 0; i < q; i++)
      linear.cross.row(i) = linear.by_yaw[i] * c.row(YAW) + linear.by_place(i, 0) * c.row(PLACES + 2 * i) +
                            linear.by_place(i, 1) * c.row(PLACES + 2 * i + 1);
    linear.columns.middleCols(POSE, 3) = linear.cross.leftCols(3);
    for (size_t j = 0; j < q; j++) {
      linear.columns.col(REST + j) = linear.by_yaw[j] * linear.cross.col(YAW) +
                                     linear.by_place(j, 0) * linear.cross.col(PLACES + 2 * j) +
                                     linear.by_place(j, 1) * linear.cross.col(PLACES + 2 * j + 1);
      linear.columns(j, REST + j) += sigmas_.data()[j] * sigmas_.data()[j];
    }
  }

  double length(const Vector3 &step) const {
    return std::max(std::max(std::abs(step[0]), std::abs(step[1])) / max_step_, std::abs(step[2]) / tunables_.max_turn);
  }

  // sets.position_root() is not None.
  bool is_determined(const Matrix3 &s) const {
    if (!(s(2, 2) > 0.0)) return false;
    const double x = s(0, 0) - s(0, 2) * s(0, 2) / s(2, 2);
    if (!(x > tunables_.rounding * s(0, 0))) return false;
    const double cross = s(0, 1) - s(0, 2) * s(1, 2) / s(2, 2);
    return s(1, 1) - s(1, 2) * s(1, 2) / s(2, 2) - cross * cross / x > tunables_.rounding * s(1, 1);
  }

  // sets.solved(), or nothing.
  std::optional<Solution> solved(const Linear &linear, const bool *inliers) const {
    std::vector<size_t> members, rest;
    for (size_t i = 0; i < q; i++) (inliers[i] ? members : rest).push_back(i);
    const size_t r = members.size(), others = rest.size();
    // Whitened: the columns, those with the other home bearings, and the identity.
    Eigen::MatrixXd spread(r, r), columns = Eigen::MatrixXd::Zero(r, REST + others + r);
    for (size_t a = 0; a < r; a++) {
      for (size_t b = 0; b < r; b++) spread(a, b) = linear.columns(members[a], REST + members[b]);
      columns.row(a).head(REST) = linear.columns.row(members[a]).head(REST);
      for (size_t b = 0; b < others; b++) columns(a, REST + b) = linear.columns(members[a], REST + rest[b]);
      columns(a, REST + others + a) = 1.0;
    }
    Solution found;
    found.weighted = Matrix::Zero(q, 4), found.alone = Matrix(q, 5), found.walk_information.setZero();
    Eigen::MatrixXd products = Eigen::MatrixXd::Zero(REST, REST);
    double log_volume = 0.0;
    if (r) {  // of matrices without rows, Eigen divides by zero
      const Eigen::LLT<Eigen::MatrixXd> llt(spread);
      if (llt.info() != Eigen::Success) return {};
      llt.matrixL().solveInPlace(columns);
      products.noalias() = columns.leftCols(REST).transpose() * columns.leftCols(REST);
      Eigen::MatrixXd weighted = columns.leftCols(4);
      llt.matrixU().solveInPlace(weighted);
      for (size_t a = 0; a < r; a++) {
        const size_t i = members[a];
        log_volume += 2.0 * std::log(llt.matrixLLT()(a, a));
        found.weighted.row(i) = weighted.row(a);
        found.alone(i, 4) = 1.0 / columns.col(REST + others + a).squaredNorm();
        found.alone.row(i).head(4) = found.weighted.row(i) * found.alone(i, 4);
        const Fixed<2, 1> by_place = linear.by_place.row(i);
        const double walks = by_place.dot(Eigen::Map<const Fixed<2, 2>>(walk_excess_.data() + 4 * i) * by_place);
        const Vector3 by_home = weighted.row(a).head(3);
        found.walk_information += walks * by_home * by_home.transpose();
      }
    }
    for (size_t b = 0; b < others; b++) {
      const auto column = columns.col(REST + b);
      found.alone.row(rest[b]).head(4) = linear.columns.row(rest[b]).head(4) - column.transpose() * columns.leftCols(4);
      found.alone(rest[b], 4) = linear.columns(rest[b], REST + rest[b]) - column.squaredNorm();
    }
    found.information = information() + products.topLeftCorner(3, 3);
    Vector3 slope = products.block<3, 1>(HOME, RESIDUAL);
    double square = products(RESIDUAL, RESIDUAL);
    if (prior_.is_valid()) {
      Vector3 offset = vector3(prior_) - linear.at;
      offset[2] = wrap(offset[2]);
      slope += information() * offset, square += offset.dot(information() * offset);
    }
    const Eigen::LLT<Eigen::Matrix3d> llt{Eigen::Matrix3d(found.information)};
    if (llt.info() != Eigen::Success) return {};
    found.step = llt.solve(slope);
    if (!std::isfinite(found.step.squaredNorm()) || !is_determined(found.information)) return {};
    found.step /= std::max(1.0, length(found.step));
    found.inverse = llt.solve(Eigen::Matrix3d::Identity());
    found.pose_by_home = products.block<3, 3>(POSE, HOME);
    found.pose = mean().head(3) + products.block<3, 1>(POSE, RESIDUAL) - found.pose_by_home * found.step;
    found.pose_covariance = covariance().topLeftCorner(3, 3) - products.block<3, 3>(POSE, POSE);
    square -= found.step.dot(found.information * found.step);
    const double log_determinant = 2.0 * std::log(llt.matrixLLT().diagonal().prod());
    found.log_density = 0.5 * ((3.0 - double(r)) * LOG_TWO_PI - log_determinant - square - log_volume);
    return found;
  }

  // sets._log_moved().
  Vector log_moved(const Vector3 &home, const Vector &off, const Vector &variance, const Vector &wrong) const {
    const size_t b = members_.shape(0);
    Vector found = Vector::Zero(b);
    for (size_t j = 0; j < b; j++) {
      const bool *inside = members_.data() + j * q;
      const size_t lead = std::find(inside, inside + q, true) - inside;
      const auto place = [this](size_t i) { return mean().segment<2>(PLACES + 2 * i); };
      for (size_t i = lead + 1; i < q; i++) {
        if (!inside[i]) continue;
        const double turned = (place(i) - place(lead)).squaredNorm() / std::max((place(lead) - home.head<2>()).squaredNorm(), 1e-12);
        found[j] += log_inlier(wrap(off[i] - off[lead]), turned + variance[i] + variance[lead]) - wrong[i];
      }
    }
    return found;
  }

  const size_t q, n;
  const In mean_, covariance_, bearings_, sigmas_, mount_, offsets_, prior_, information_, walk_excess_;
  const Flags members_;
  const In one_body_;
  const bool same_camera_;
  const double moved_prior_, max_step_;
  const SetTunables tunables_;
};

nb::object log_labels(Flags members, In one_body, Flags right, In wrong, In more, double upheaval) {
  const size_t b = one_body.size(), k = wrong.size(), f = right.shape(0);
  require_shape("members", members, {b, k}), require_shape("right", right, {f, k}), require_shape("more", more, {b});
  const LabelPrior prior(members, one_body.data(), Eigen::Map<const Vector>(wrong.data(), k), more.data(), upheaval);
  Vector found(f);
  for (size_t row = 0; row < f; row++) found[row] = prior(right.data() + row * k);
  return nb::cast(array_of(found, {f}));
}

// Arrays are taken as they are: a copy of one with another layout would be written to in vain.
auto array(const char *name) { return nb::arg(name).noconvert(); }

}  // namespace

}  // namespace homeward

void bind_sets(nanobind::module_ &m) {
  using namespace homeward;
  nb::class_<SetTunables>(m, "SetTunables")
      .def(nb::init<double, double, double, double, double, double>(), nb::arg("max_turn"), nb::arg("converged"),
           nb::arg("rounding"), nb::arg("min_distance"), nb::arg("outlier_sigma"), nb::arg("upheaval"));
  nb::class_<Home>(m, "Home")
      .def(nb::init<In, In, In, In, In, In, In, In, In, Flags, In, bool, double, double, const SetTunables &>(),
           array("mean"), array("covariance"), array("bearings"), array("sigmas"), array("mount"),
           array("offsets").none(), array("prior").none(), array("information"), array("walk_excess"),
           array("members"), array("one_body"), nb::arg("same_camera"), nb::arg("moved_prior"), nb::arg("max_step"),
           nb::arg("tunables"))
      .def("fit", &Home::fit, array("home"), array("inliers"), nb::arg("steps"))
      .def("propagate", &Home::propagate, array("at"), array("by_place"), array("by_yaw"), array("cross_covariance"),
           array("columns"), array("mean"), array("inliers"))
      .def("solve", &Home::solve, array("at"), array("by_place"), array("by_yaw"), array("cross_covariance"),
           array("columns"), array("inliers"))
      .def("weigh", &Home::weigh, array("at"), array("inliers"), array("step"), array("inverse"), array("alone"),
           nb::arg("log_density"));
  m.def("log_labels", &log_labels, array("members"), array("one_body"), array("right"), array("wrong"), array("more"),
        nb::arg("upheaval"));
}

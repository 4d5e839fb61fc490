// Normal equations of the window, and their solution: the text to read is reference/window.py.
#include "algebra.h"

#include <algorithm>
#include <vector>

namespace homeward {
namespace {

constexpr int STEP = 13 + 3 * NC, INFORMATION = 3, BY_CALIBRATION = 12;
constexpr double MIN_SQUARED_DISTANCE = 1e-6, TURN = 6.283185307179586;

double wrap(double x) { return x - TURN * std::ceil((x - 0.5 * TURN) / TURN); }

// Normal equations as NumPy holds them; everything is added in place.
struct Equations {
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
  size_t w, a;
  double *own, *next, *shared, *common, *slope, *common_slope;
};

// Motions between keyframes: odometry_errors and add_odometry.
void add_odometry(In poses, In calibration, In steps, Out own, Out next, Out shared, Out common, Out slope,
                  Out common_slope) {
  const Equations e(own, next, shared, common, slope, common_slope);
  require_shape("poses", poses, {e.w, 3}), require_shape("calibration", calibration, {NC});
  require_shape("steps", steps, {e.w - 1, STEP});
  const Eigen::Map<const Fixed<NC, 1>> cal(calibration.data());
  const double size = 1.0 + cal[SPEED_SCALE];
  const Vector3 scale(1.0 / size, 1.0 / size, 1.0);
  for (size_t k = 0; k + 1 < e.w; k++) {
    const double *row = steps.data() + STEP * k, *p = poses.data() + 3 * k;
    const Eigen::Map<const Vector3> free(row);
    const Eigen::Map<const Matrix3> information(row + INFORMATION);
    const Eigen::Map<const Jacobian> by_calibration(row + BY_CALIBRATION);
    const double c = std::cos(p[2]), s = std::sin(p[2]), x = p[3] - p[0], y = p[4] - p[1];
    Matrix3 back = Matrix3::Identity(), lever = Matrix3::Identity();
    back(0, 0) = back(1, 1) = c, back(0, 1) = s, back(1, 0) = -s;
    lever(0, 2) = -y, lever(1, 2) = x;
    const Vector3 between(c * x + s * y, c * y - s * x, p[5] - p[2]);
    const Vector3 error = (free + by_calibration * cal - between).cwiseProduct(scale);
    Fixed<3, 6 + NC> jacobian;
    jacobian.leftCols<3>() = -back * lever;
    jacobian.middleCols<3>(3) = back;
    jacobian.rightCols<NC>() = -by_calibration;
    jacobian.block<2, 1>(0, 6 + SPEED_SCALE) += error.head<2>();
    jacobian = scale.asDiagonal() * jacobian;
    const double weight = 4.0 / std::max(1.0 + error.dot(information * error), 4.0);
    const Fixed<3, 6 + NC> weighted = weight * information * jacobian;
    const Vector3 pulled = weight * information * error;
    const Fixed<6 + NC, 6 + NC> blocks = jacobian.transpose() * weighted;
    const Fixed<6 + NC, 1> pull = jacobian.transpose() * pulled;
    e.own_of(k) += blocks.topLeftCorner<3, 3>();
    e.own_of(k + 1) += blocks.block<3, 3>(3, 3);
    e.next_of(k) += blocks.block<3, 3>(0, 3);
    e.shared_of(k).leftCols<NC>() += blocks.block<3, NC>(0, 6);
    e.shared_of(k + 1).leftCols<NC>() += blocks.block<3, NC>(3, 6);
    e.slope_of(k) += pull.head<3>(), e.slope_of(k + 1) += pull.segment<3>(3);
    e.common_all().topLeftCorner<NC, NC>() += blocks.bottomRightCorner<NC, NC>();
    e.common_slope_all().head<NC>() += pull.tail<NC>();
  }
}

// Factors of one sighting each: of a pose, the calibration and a landmark.
void add_one(const Equations &e, const double *j, double residual, size_t pose, size_t landmark) {
  const Eigen::Map<const Fixed<3, 1>> by_pose(j);
  const Eigen::Map<const Fixed<NC, 1>> by_calibration(j + 3);
  const Eigen::Map<const Fixed<2, 1>> by_landmark(j + HEAD);
  const size_t at = NC + 2 * landmark;
  e.own_of(pose) += by_pose * by_pose.transpose();
  auto shared = e.shared_of(pose);
  shared.leftCols<NC>() += by_pose * by_calibration.transpose();
  shared.middleCols<2>(at) += by_pose * by_landmark.transpose();
  e.slope_of(pose) += residual * by_pose;
  auto common = e.common_all();
  common.topLeftCorner<NC, NC>() += by_calibration * by_calibration.transpose();
  common.block<2, 2>(at, at) += by_landmark * by_landmark.transpose();
  const Fixed<2, NC> cross = by_landmark * by_calibration.transpose();
  common.block<2, NC>(at, 0) += cross;
  common.block<NC, 2>(0, at) += cross.transpose();
  e.common_slope_all().head<NC>() += residual * by_calibration;
  e.common_slope_all().segment<2>(at) += residual * by_landmark;
}

// Sightings that are linearised and weighted already: reference.window.add_sightings().
void add_sightings(In residual, In jacobian, Numbers poses_of, Numbers landmarks_of, Out own, Out next, Out shared,
                   Out common, Out slope, Out common_slope) {
  const Equations e(own, next, shared, common, slope, common_slope);
  const size_t m = residual.size(), n = (e.a - NC) / 2;
  require_shape("residual", residual, {m}), require_shape("jacobian", jacobian, {m, HEAD + 2});
  require_shape("pose", poses_of, {m}), require_shape("landmark", landmarks_of, {m});
  for (size_t i = 0; i < m; i++) {
    const size_t pose = size_t(poses_of.data()[i]), mark = size_t(landmarks_of.data()[i]);
    if (pose >= e.w || mark >= n) throw nb::index_error("a sighting of another window");
    add_one(e, jacobian.data() + (HEAD + 2) * i, residual.data()[i], pose, mark);
  }
}

// Bearings: reference.window.add_bearings().
void add_bearings(In bearings, In sigmas, In effective, Numbers frames_of, Numbers landmarks_of, Numbers poses_of,
                  In free, In jacobians, In poses, In unknowns, double gate, Out own, Out next, Out shared, Out common,
                  Out slope, Out common_slope) {
  const Equations e(own, next, shared, common, slope, common_slope);
  const size_t m = bearings.shape(0), f = free.shape(0), n = (e.a - NC) / 2;
  require_shape("bearings", bearings, {m}), require_shape("sigmas", sigmas, {m}), require_shape("effective", effective, {m});
  require_shape("frame", frames_of, {m}), require_shape("landmark", landmarks_of, {m}), require_shape("pose", poses_of, {f});
  require_shape("free", free, {f, 3}), require_shape("jacobians", jacobians, {f, 3, NC});
  require_shape("poses", poses, {e.w, 3}), require_shape("shared", unknowns, {NC + 2 * n});
  const Eigen::Map<const Fixed<NC, 1>> calibration(unknowns.data());
  size_t of = f;  // the frame of the last bearing, whose camera is known; none yet
  Vector3 eye = Vector3::Zero();
  Fixed<3, HEAD> by_head = Fixed<3, HEAD>::Zero();
  for (size_t i = 0; i < m; i++) {
    const size_t frame = size_t(frames_of.data()[i]), mark = size_t(landmarks_of.data()[i]);  // negative: huge
    if (frame >= f || mark >= n) throw nb::index_error("a sighting of another window");
    const size_t pose = size_t(poses_of.data()[frame]);
    if (pose >= e.w) throw nb::index_error("a frame of another window");
    if (frame != of) {
      of = frame;
      const Eigen::Map<const Jacobian> by(jacobians.data() + 3 * NC * frame);
      const Vector3 camera = Eigen::Map<const Vector3>(free.data() + 3 * frame) + by * calibration;
      const Composition there(Eigen::Map<const Vector3>(poses.data() + 3 * pose), camera);
      eye = there.pose;
      by_head.leftCols<3>() = there.by_a;
      by_head.rightCols<NC>() = there.by_b * by;
    }
    const double *place = unknowns.data() + NC + 2 * mark;
    const double dx = place[0] - eye[0], dy = place[1] - eye[1];
    const double square = std::max(dx * dx + dy * dy, MIN_SQUARED_DISTANCE);
    const double residual = wrap(bearings.data()[i] - (std::atan2(dy, dx) - eye[2]));
    const double outlying = std::max(std::abs(residual) / (gate * sigmas.data()[i]), 1.0);
    const double scale = 1.0 / (effective.data()[i] * outlying);
    Fixed<1, HEAD + 2> j;
    const Fixed<1, 3> by_eye(dy / square, -dx / square, -1.0);
    j.leftCols<HEAD>() = by_eye * by_head;
    j[HEAD] = -dy / square, j[HEAD + 1] = dx / square;
    j *= scale;
    add_one(e, j.data(), scale * residual, pose, mark);
  }
}

// Eliminate the chain of poses, solve, and invert: eliminate() and Elimination.solve().
nb::tuple solve_chain(Out own, Out next, Out shared, Out common, Out slope, Out common_slope) {
  const Equations e(own, next, shared, common, slope, common_slope);
  const size_t w = e.w, a = e.a, n = 3 + a;
  Matrix information(n, n);
  information.topLeftCorner(3, 3) = e.own_of(w - 1);
  information.topRightCorner(3, a) = e.shared_of(w - 1);
  information.bottomLeftCorner(a, 3) = information.topRightCorner(3, a).transpose();
  information.bottomRightCorner(a, a) = e.common_all();
  Vector gradient(n);
  gradient << e.slope_of(w - 1), e.common_slope_all();
  // Of each eliminated pose: the inverse of its factor times its blocks with the newest pose and the shared
  // unknowns (n), and its gradient (1). All rows together have one product at the end.
  Matrix rows = Matrix::Zero(3 * (w - 1), n + 1);
  std::vector<Matrix3> factors(w - 1), following(factors.size());
  Matrix3 block = e.own_of(0);
  {
    nb::gil_scoped_release release;
    for (size_t k = 0; k + 1 < w; k++) {
      const Eigen::LLT<Eigen::Matrix3d> llt{Eigen::Matrix3d(block)};
      if (llt.info() != Eigen::Success) throw std::domain_error("a pose is not determined");
      auto row = rows.middleRows(3 * k, 3);
      row.block(0, 3, 3, a) += e.shared_of(k);
      row.col(n) += e.slope_of(k);
      const auto coupling = e.next_of(k);
      const Eigen::Matrix3d lower = llt.matrixL();
      factors[k] = lower;
      following[k] = lower.triangularView<Eigen::Lower>().solve(Eigen::Matrix3d(coupling));
      const bool last = k + 2 == w;
      if (last) row.leftCols(3) = coupling;
      lower.triangularView<Eigen::Lower>().solveInPlace(row);
      if (!last) {
        block = e.own_of(k + 1) - following[k].transpose() * following[k];
        rows.middleRows(3 * (k + 1), 3).noalias() -= following[k].transpose() * row;
      }
    }
    information.noalias() -= rows.leftCols(n).transpose() * rows.leftCols(n);
    gradient.noalias() -= rows.leftCols(n).transpose() * rows.col(n);
  }
  information = (0.5 * (information + information.transpose())).eval();
  const Eigen::LLT<Eigen::MatrixXd> llt{Eigen::MatrixXd(information)};
  if (llt.info() != Eigen::Success) throw std::domain_error("not positive definite");
  Eigen::MatrixXd covariance = llt.solve(Eigen::MatrixXd::Identity(n, n));
  covariance = (0.5 * (covariance + covariance.transpose())).eval();
  const Vector tail = covariance * gradient;
  Matrix steps(w, 3);
  steps.row(w - 1) = tail.head(3);
  Vector right = rows.col(n) - rows.leftCols(n) * tail;
  for (size_t k = w - 1; k-- > 0;) {
    Eigen::Vector3d x = right.segment<3>(3 * k);
    if (k + 2 < w) x -= following[k] * Eigen::Vector3d(steps.row(k + 1));
    Eigen::Matrix3d lower = factors[k];
    lower.transpose().triangularView<Eigen::Upper>().solveInPlace(x);
    steps.row(k) = x;
  }
  return nb::make_tuple(array_of(steps, {w, 3}), array_of(Matrix(tail.tail(a)), {a}),
                        array_of(Matrix(covariance), {n, n}));
}

// Arrays are taken as they are: a copy of one with another layout would be written to in vain.
auto array(const char *name) { return nb::arg(name).noconvert(); }

}  // namespace

}  // namespace homeward

void bind_window(nanobind::module_ &m) {
  using namespace homeward;
  m.def("add_odometry", &add_odometry, array("poses"), array("calibration"), array("steps"), array("own"),
        array("next"), array("shared"), array("common"), array("slope"), array("common_slope"));
  m.def("add_sightings", &add_sightings, array("residual"), array("jacobian"), array("pose"), array("landmark"),
        array("own"), array("next"), array("shared"), array("common"), array("slope"), array("common_slope"));
  m.def("add_bearings", &add_bearings, array("bearings"), array("sigmas"), array("effective"), array("frame"),
        array("landmark"), array("pose"), array("free"), array("jacobians"), array("poses"), array("unknowns"),
        nb::arg("gate"), array("own"), array("next"), array("shared"), array("common"), array("slope"),
        array("common_slope"));
  m.def("solve_chain", &solve_chain, array("own"), array("next"), array("shared"), array("common"), array("slope"),
        array("common_slope"));
}

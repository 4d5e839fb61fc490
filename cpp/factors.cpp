// Factors of the window: the text to read is reference/factors.py.
#include <algorithm>
#include <cstring>

#include "equations.h"

namespace homeward {
namespace {

constexpr int INFORMATION = 3, BY_CALIBRATION = 12, PER_S = STEP - 1;

class FrameSum {
 public:
  // Begin a frame: the camera's pose, seen from a keyframe at a pose, and its Jacobian by both. At the keyframe itself,
  // it does not depend on most of the calibration.
  void begin(const double *pose, const double *free, const double *jacobian, const Fixed<NC, 1> &calibration) {
    const Eigen::Map<const Jacobian> by(jacobian);
    const Vector3 camera = Eigen::Map<const Vector3>(free) + by * calibration;
    const Composition there(Eigen::Map<const Vector3>(pose), camera);
    eye = there.pose;
    by_head.leftCols<3>() = there.by_a;
    n = 3;
    for (int k = 0; k < NC; k++)
      if (by.col(k) != Vector3::Zero()) columns[n] = 3 + k, by_head.col(n++) = there.by_b * by.col(k);
    square.setZero(), slope.setZero();
  }
  void add(double x, double y, double turn, double residual) {
    square(0, 0) += x * x, square(0, 1) += x * y, square(0, 2) += x * turn;
    square(1, 1) += y * y, square(1, 2) += y * turn, square(2, 2) += turn * turn;
    slope += residual * Vector3(x, y, turn);
  }
  void end(const Equations &e, size_t pose) {
    square(1, 0) = square(0, 1), square(2, 0) = square(0, 2), square(2, 1) = square(1, 2);
    for (int i = 0; i < n; i++) {
      const Vector3 weighted = square * by_head.col(i);
      const bool is_pose = i < 3;
      double *own = e.own + 9 * pose + 3 * i, *shared = e.shared + 3 * e.a * pose + e.a * i;
      if (!is_pose) shared = e.common + e.a * (columns[i] - 3);
      for (int j = is_pose ? 0 : 3; j < n; j++)
        (j < 3 ? own[j] : shared[columns[j] - 3]) += by_head.col(j).dot(weighted);
      (is_pose ? e.slope[3 * pose + i] : e.common_slope[columns[i] - 3]) += by_head.col(i).dot(slope);
    }
  }
  Vector3 eye;
  int n, columns[HEAD] = {0, 1, 2};  // of keyframe's pose (3) and calibration, on which it depends
  Eigen::Matrix<double, 3, HEAD> by_head;  // the Jacobian by these

 private:
  Matrix3 square;
  Vector3 slope;
};

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

// Sightings that are linearised and weighted already: reference.factors.add_sightings().
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

}  // namespace

OwnEquations::OwnEquations(size_t w, size_t a) : Equations(w, a) {
  const size_t sizes[] = {9 * w, 9 * (w - 1), 3 * a * w, a * a, 3 * w, a};
  double **const parts[] = {&own, &next, &shared, &common, &slope, &common_slope};
  size_ = 0;
  for (size_t size : sizes) size_ += size;
  double *at = new double[size_]();
  owner_ = nb::capsule(at, [](void *p) noexcept { delete[] static_cast<double *>(p); });
  for (size_t k = 0; k < 6; k++) *parts[k] = at, at += sizes[k];
}

void OwnEquations::clear() { std::memset(own, 0, size_ * sizeof(double)); }

nb::tuple OwnEquations::arrays() const {
  const auto array = [&](double *data, std::initializer_list<size_t> shape) {
    return nb::ndarray<nb::numpy, double>(data, shape.size(), shape.begin(), owner_);
  };
  return nb::make_tuple(array(own, {w, 3, 3}), array(next, {w - 1, 3, 3}), array(shared, {w, 3, a}),
                        array(common, {a, a}), array(slope, {w, 3}), array(common_slope, {a}));
}

// Motions between poses: odometry_errors and add_odometry.
void add_odometry(const Equations &e, const double *poses, const double *calibration, const double *steps,
                  const Linearised &rows) {
  const Eigen::Map<const Fixed<NC, 1>> cal(calibration);
  const double size = 1.0 + cal[SPEED_SCALE];
  for (size_t k = 0; k + 1 < e.w; k++) {
    const double *row = steps + STEP * k, *p = poses + 3 * k;
    const Eigen::Map<const Vector3> free(row);
    const Eigen::Map<const Matrix3> information(row + INFORMATION);
    const Eigen::Map<const Jacobian> by_calibration(row + BY_CALIBRATION);
    const bool strafes = by_calibration(1, SIDEWAYS_SCALE) != 0.0;
    const double aside = strafes ? 1.0 + cal[SIDEWAYS_SCALE] : 1.0;
    const Vector3 scale(1.0 / size, 1.0 / (size * aside), 1.0);
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
    jacobian(0, 6 + SPEED_SCALE) += error[0], jacobian(1, 6 + SPEED_SCALE) += aside * error[1];
    if (strafes) jacobian(1, 6 + SIDEWAYS_SCALE) += size * error[1];
    jacobian = scale.asDiagonal() * jacobian;
    if (strafes) jacobian.middleCols<2>(6 + DELAY).colwise() -= row[PER_S] * error;
    const double weight = 4.0 / std::max(1.0 + error.dot(information * error), 4.0);
    if (rows.weight) {
      Eigen::Map<Vector3>(rows.error + 3 * k) = error, rows.weight[k] = weight;
      Eigen::Map<Fixed<3, 6 + NC>>(rows.by_motion + jacobian.size() * k) = jacobian;
    }
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

// Bearings: add_bearings. The bearings of one frame share the camera's pose, so that their products
// are summed by that pose (3) and turned into products by keyframe and calibration (12) once.
void add_bearings(const Equations &e, const Bearings &seen, const double *poses, const double *unknowns, double gate,
                  const Linearised &rows) {
  const size_t n = (e.a - NC) / 2;
  const Fixed<NC, 1> calibration = Eigen::Map<const Fixed<NC, 1>>(unknowns);
  Matrix cross = Matrix::Zero(2 * n, NC);  // of landmarks and calibration
  FrameSum sum;
  size_t of = seen.f, pose = 0;  // the frame of the last bearing; none yet
  for (size_t i = 0; i < seen.m; i++) {
    const size_t frame = size_t(seen.frames[i]), mark = size_t(seen.landmarks[i]);  // negative: huge
    if (frame >= seen.f || mark >= n) throw nb::index_error("a sighting of another window");
    if (frame != of) {
      if (of != seen.f) sum.end(e, pose);
      of = frame, pose = size_t(seen.poses[frame]);
      if (pose >= e.w) throw nb::index_error("a frame of another window");
      sum.begin(poses + 3 * pose, seen.free + 3 * frame, seen.jacobians + 3 * NC * frame, calibration);
    }
    const double *place = unknowns + NC + 2 * mark;
    const double dx = place[0] - sum.eye[0], dy = place[1] - sum.eye[1];
    const double square = std::max(dx * dx + dy * dy, MIN_SQUARED_DISTANCE);
    const double off = wrap(seen.bearings[i] - (std::atan2(dy, dx) - sum.eye[2]));
    const double outlying = std::max(std::abs(off) / (gate * seen.sigmas[i]), 1.0);
    const double scale = 1.0 / (seen.effective[i] * outlying), residual = scale * off;
    // By the landmark (x, y); by the camera's pose it is (-x, -y, -scale).
    const double x = -scale * dy / square, y = scale * dx / square;
    sum.add(-x, -y, -scale, residual);
    double head[HEAD];  // by the columns
    for (int k = 0; k < sum.n; k++)
      head[k] = -x * sum.by_head(0, k) - y * sum.by_head(1, k) - scale * sum.by_head(2, k);
    if (rows.residual) {
      double *row = rows.by_bearing + (HEAD + 2) * i;
      std::fill_n(row, HEAD, 0.0);
      for (int k = 0; k < sum.n; k++) row[sum.columns[k]] = head[k];
      row[HEAD] = x, row[HEAD + 1] = y, rows.residual[i] = residual;
    }
    const size_t at = NC + 2 * mark;
    double *shared_at = e.shared + 3 * e.a * pose + at, *common_at = e.common + e.a * at + at;
    double *cross_at = cross.data() + 2 * NC * mark - 3;
    for (size_t k = 0; k < 3; k++) shared_at[e.a * k] += x * head[k], shared_at[e.a * k + 1] += y * head[k];
    for (int k = 3; k < sum.n; k++)
      cross_at[sum.columns[k]] += x * head[k], cross_at[NC + sum.columns[k]] += y * head[k];
    common_at[0] += x * x, common_at[1] += x * y, common_at[e.a] += x * y, common_at[e.a + 1] += y * y;
    e.common_slope[at] += residual * x, e.common_slope[at + 1] += residual * y;
  }
  if (of != seen.f) sum.end(e, pose);
  e.common_all().bottomLeftCorner(2 * n, NC) += cross;
  e.common_all().topRightCorner(NC, 2 * n) += cross.transpose();
}

}  // namespace homeward

void bind_factors(nanobind::module_ &m) {
  using namespace homeward;
  const auto array = [](const char *name) { return nb::arg(name).noconvert(); };
  m.def("add_sightings", &add_sightings, array("residual"), array("jacobian"), array("pose"), array("landmark"),
        array("own"), array("next"), array("shared"), array("common"), array("slope"), array("common_slope"));
}

// One frame and its gate: the text to read is reference/frame.py.
#include <algorithm>
#include <vector>

#include "algebra.h"

namespace homeward {
namespace {

using Square = Eigen::MatrixXd;
using Mask = std::vector<bool>;

// Constants of localizer/tunables.py.
struct GateTunables {
  double false_alarm, inflation, linear, majority, min_sigma, vague, rounding, turn_limit;
  size_t minimal;
};

// The camera after a motion: camera_after() and cameras().
struct Camera {
  Camera(const double *mean, const Vector3 &delta, const Jacobian &by_calibration, const double *mount,
         const double *offset) {
    const Eigen::Map<const Fixed<NC, 1>> calibration(mean + 3);
    const Vector3 shift(calibration[CAMERA_X], calibration[CAMERA_Y], calibration[CAMERA_YAW]);
    const Composition first(delta, Eigen::Map<const Vector3>(mount) + shift);
    const Composition last(first.pose, Eigen::Map<const Vector3>(offset));
    jacobian = first.by_a * by_calibration;
    jacobian.col(CAMERA_X) += first.by_b.col(0);
    jacobian.col(CAMERA_Y) += first.by_b.col(1);
    jacobian.col(CAMERA_YAW) += first.by_b.col(2);
    jacobian = (last.by_a * jacobian).eval();
    free = last.pose - jacobian * calibration;
    const Composition there(Eigen::Map<const Vector3>(mean), last.pose);
    eye = there.pose;
    by_head << there.by_a, there.by_b * jacobian;
  }
  Vector3 free, eye;
  Jacobian jacobian;
  Fixed<3, HEAD> by_head;
};

nb::tuple propagate(In mean, In covariance, In free, In motion_covariance, In jacobian) {
  const size_t d = mean.size();
  if (d < HEAD) throw nb::value_error("mean has another shape");
  require_shape("mean", mean, {d}), require_shape("covariance", covariance, {d, d}), require_shape("free", free, {3});
  require_shape("motion_covariance", motion_covariance, {3, 3}), require_shape("jacobian", jacobian, {3, NC});
  const Eigen::Map<const Jacobian> by(jacobian.data());
  const Eigen::Map<const Matrix3> noise(motion_covariance.data());
  const Eigen::Map<const Fixed<NC, 1>> calibration(mean.data() + 3);
  const Vector3 moved = Eigen::Map<const Vector3>(free.data()) + by * calibration;
  const Composition there(Eigen::Map<const Vector3>(mean.data()), moved);
  Fixed<3, HEAD> by_head;
  by_head << there.by_a, there.by_b * by;
  Vector now = Eigen::Map<const Vector>(mean.data(), d);
  now.head<3>() = there.pose;
  Matrix spread = Eigen::Map<const Matrix>(covariance.data(), d, d);
  spread.topRows<3>() = (by_head * spread.topRows<HEAD>()).eval();
  spread.leftCols<3>() = (spread.leftCols<HEAD>() * by_head.transpose()).eval();
  spread.topLeftCorner<3, 3>() += there.by_b * noise * there.by_b.transpose();
  return nb::make_tuple(array_of(now, {d}), array_of(spread, {d, d}));
}

// _data_snooping(): remove from `kept` those that do not agree with the others.
void snoop(Mask &kept, const Vector &residual, const Square &covariance, double gate, size_t minimal) {
  const Eigen::LLT<Square> llt(covariance);
  if (llt.info() != Eigen::Success) return;  // no test is possible
  Square information = llt.solve(Square::Identity(residual.size(), residual.size()));
  information = (0.5 * (information + information.transpose())).eval();
  for (size_t count = kept.size(); count >= minimal; count--) {
    const Vector weighted = information * residual;
    double largest = 0.0;
    size_t worst = 0;
    for (size_t i = 0; i < kept.size(); i++) {
      const double square = kept[i] ? weighted[i] * weighted[i] / information(i, i) : 0.0;
      if (square > largest) largest = square, worst = i;
    }
    if (!(largest > gate * gate)) return;
    kept[worst] = false;
    const Vector row = information.row(worst);
    information.noalias() -= row / row[worst] * row.transpose();
  }
}

Mask consistent_subset(const Vector &residual, Square covariance, double gate, const Mask &likely,
                       const GateTunables &tunables) {
  const size_t m = residual.size();
  const auto count = [](const Mask &of) { return double(std::count(of.begin(), of.end(), true)); };
  Mask kept(m, true);
  const double largest = std::max(covariance.diagonal().maxCoeff(), 0.0);
  covariance.diagonal().array() += tunables.min_sigma * tunables.min_sigma + tunables.rounding * largest;
  snoop(kept, residual, covariance, gate, tunables.minimal);
  if (count(kept) >= tunables.majority * m) return kept;
  return count(likely) >= std::max(double(tunables.minimal), 0.5 * m) ? likely : Mask(m, true);
}

// The bearings of mapped landmarks, their prediction, and the tests.
struct Seen {
  Seen(size_t k) : residual(k), by_place(2, k), covariance(k, k) {}

  // predict_bearings(); `at` has the columns of the landmarks.
  void predict(const double *mean, const Eigen::Map<const Matrix> &state, const Camera &camera, const Indices &at,
               const double *bearings, const double *sigmas, const Indices &known) {
    const size_t k = known.size();
    Eigen::Matrix<double, 3, Eigen::Dynamic> by_eye(3, k), shared(3, k);
    for (size_t i = 0; i < k; i++) {
      const double dx = mean[at[i]] - camera.eye[0], dy = mean[at[i] + 1] - camera.eye[1];
      const double square = std::max(dx * dx + dy * dy, MIN_SQUARED_DISTANCE);
      residual[i] = wrap(bearings[known[i]] - (std::atan2(dy, dx) - camera.eye[2]));
      by_place.col(i) << -dy / square, dx / square;
      by_eye.col(i) << dy / square, -dx / square, -1.0;
      shared.col(i) = camera.by_head * (state.block<HEAD, 2>(0, at[i]) * by_place.col(i));
    }
    const Matrix3 own = camera.by_head * state.topLeftCorner<HEAD, HEAD>() * camera.by_head.transpose();
    covariance = by_eye.transpose() * (own * by_eye + shared) + shared.transpose() * by_eye;
    for (size_t i = 0; i < k; i++)
      for (size_t j = 0; j < k; j++)
        covariance(i, j) += by_place.col(i).dot(state.block<2, 2>(at[i], at[j]) * by_place.col(j));
    for (size_t i = 0; i < k; i++)
      covariance(i, i) = std::max(covariance(i, i), 0.0) + sigmas[known[i]] * sigmas[known[i]];
  }

  // motion_covariance()
  Square by_motion(const Matrix3 &motion, double heading) const {
    const double c = std::cos(heading), s = std::sin(heading);
    Eigen::Matrix<double, Eigen::Dynamic, 3> by(residual.size(), 3);
    by.col(0) = c * by_place.row(0) + s * by_place.row(1);
    by.col(1) = c * by_place.row(1) - s * by_place.row(0);
    by.col(2).setOnes();
    return by * motion * by.transpose();
  }

  // joint_square()
  double joint_square(const Square &by_motion, const Mask &accepted, const GateTunables &tunables) const {
    Indices among;
    for (size_t i = 0; i < accepted.size(); i++)
      if (accepted[i]) among.push_back(i);
    const bool both = among.size() == 2 && accepted.size() == 2;
    if (among.size() < tunables.minimal && !(both && shows_turn(tunables))) return 0.0;
    const Eigen::LLT<Square> llt((covariance + by_motion)(among, among));
    const Vector off = residual(among);
    return llt.info() == Eigen::Success ? off.dot(llt.solve(off)) : 0.0;
  }

  Vector residual;
  Eigen::Matrix<double, 2, Eigen::Dynamic> by_place;
  Square covariance;

 private:
  bool shows_turn(const GateTunables &tunables) const {
    const auto a = by_place.col(0), b = by_place.col(1);
    const double apart = std::abs(std::atan2(a[0] * b[1] - a[1] * b[0], a.dot(b)));
    const double variance = covariance(0, 0) + covariance(1, 1) - 2.0 * covariance(0, 1);
    const double off = residual[1] - residual[0];
    return apart > tunables.linear && off * off <= tunables.turn_limit * variance;
  }
};

nb::tuple gate_frame(In mean, In covariance, In p_static, In delta, In motion_covariance, In jacobian, In mount,
                     In offset, In bearings, In sigmas, Numbers landmark, double scale, bool is_keyframe, double gate,
                     int stamp, int vague_stamp, const GateTunables &tunables) {
  const size_t d = mean.size(), m = bearings.size();
  if (d < HEAD || (d - HEAD) % 2) throw nb::value_error("mean has another shape");
  require_shape("mean", mean, {d}), require_shape("covariance", covariance, {d, d});
  require_shape("p_static", p_static, {(d - HEAD) / 2}), require_shape("delta", delta, {3});
  require_shape("motion_covariance", motion_covariance, {3, 3}), require_shape("jacobian", jacobian, {3, NC});
  require_shape("mount", mount, {3}), require_shape("offset", offset, {3}), require_shape("bearings", bearings, {m});
  require_shape("sigmas", sigmas, {m}), require_shape("landmark", landmark, {m});
  Indices known, at;
  for (size_t i = 0; i < m; i++) {
    if (landmark.data()[i] < 0) continue;
    known.push_back(i), at.push_back(HEAD + 2 * landmark.data()[i]);
    if (size_t(at.back()) >= d) throw nb::index_error("a landmark of another map");
  }
  const size_t k = known.size();
  Vector3 moved = Eigen::Map<const Vector3>(delta.data());
  Jacobian by_calibration = Eigen::Map<const Jacobian>(jacobian.data());
  const Matrix3 noise = Eigen::Map<const Matrix3>(motion_covariance.data());
  const double heading = mean.data()[2] - (is_keyframe ? moved[2] : 0.0);
  if (is_keyframe) moved.setZero(), by_calibration.setZero();
  const Camera camera(mean.data(), moved, by_calibration, mount.data(), offset.data());
  Seen seen(k);
  seen.predict(mean.data(), Eigen::Map<const Matrix>(covariance.data(), d, d), camera, at, bearings.data(),
               sigmas.data(), known);
  const Square by_motion = seen.by_motion(noise, heading);

  // _accepted()
  const double wider = tunables.inflation * tunables.inflation;
  Vector deviation(k), by_shift = Vector::Constant(m, 1.0 / (scale * scale));
  Mask accepted(k), likely;
  Indices among;
  for (size_t i = 0; i < k; i++) {
    by_shift[known[i]] = seen.by_place.col(i).squaredNorm();
    const double drift = noise(2, 2) + (noise(0, 0) + noise(1, 1)) * by_shift[known[i]];
    const double off = std::abs(seen.residual[i]), variance = seen.covariance(i, i) + (is_keyframe ? 0.0 : drift);
    deviation[i] = std::sqrt(variance);
    accepted[i] = off <= gate * std::sqrt(variance + (wider - 1.0) * drift);
    if (accepted[i]) among.push_back(i), likely.push_back(off <= gate * deviation[i]);
  }
  if (among.size() >= tunables.minimal) {
    const Square joint = (seen.covariance + (wider - is_keyframe) * by_motion)(among, among);
    const Mask kept = consistent_subset(seen.residual(among), joint, gate, likely, tunables);
    for (size_t i = 0; i < among.size(); i++) accepted[among[i]] = kept[i];
  }
  Vector is_accepted(k);
  for (size_t i = 0; i < k; i++)
    is_accepted[i] = accepted[i] = accepted[i] && p_static.data()[landmark.data()[known[i]]] > tunables.false_alarm;
  const double square = is_keyframe ? 0.0 : seen.joint_square(by_motion, accepted, tunables);

  // _inflated()
  Vector inflated = Eigen::Map<const Vector>(sigmas.data(), m);
  bool vague = false;
  if (!is_keyframe && m) {
    const double across = 0.5 * (noise(0, 0) + noise(1, 1));
    const double limit = tunables.vague * median({inflated.begin(), inflated.end()});
    vague = across * median({by_shift.begin(), by_shift.end()}) > limit * limit;
    const double shared = ((vague ? vague_stamp : stamp) + 1) * m * across;
    inflated = (inflated.array().square() + noise(2, 2) + shared * by_shift.array()).sqrt();
  }
  return nb::make_tuple(array_of(seen.residual, {k}), array_of(deviation, {k}), array_of(is_accepted, {k}), square,
                        array_of(inflated, {m}), vague, array_of(camera.free, {3}), array_of(camera.jacobian, {3, NC}),
                        array_of(camera.eye, {3}));
}

}  // namespace
}  // namespace homeward

void bind_frame(nanobind::module_ &m) {
  using namespace homeward;
  const auto array = [](const char *name) { return nb::arg(name).noconvert(); };
  nb::class_<GateTunables>(m, "GateTunables")
      .def(nb::init<double, double, double, double, double, double, double, double, size_t>(), nb::arg("false_alarm"),
           nb::arg("inflation"), nb::arg("linear"), nb::arg("majority"), nb::arg("min_sigma"), nb::arg("vague"),
           nb::arg("rounding"), nb::arg("turn_limit"), nb::arg("minimal"));
  m.def("propagate", &propagate, array("mean"), array("covariance"), array("free"), array("motion_covariance"),
        array("jacobian"));
  m.def("gate_frame", &gate_frame, array("mean"), array("covariance"), array("p_static"), array("delta"),
        array("motion_covariance"), array("jacobian"), array("mount"), array("offset"), array("bearings"),
        array("sigmas"), array("landmark"), nb::arg("scale"), nb::arg("is_keyframe"), nb::arg("gate"),
        nb::arg("stamp"), nb::arg("vague_stamp"), nb::arg("tunables"));
}

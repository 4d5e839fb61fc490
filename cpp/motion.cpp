// Preintegration of odometry: the text to read is reference/motion.py.
#include "algebra.h"

#include <algorithm>
#include <array>
#include <vector>

namespace homeward {
namespace {

// Columns of a twist, as TwistHistory keeps it.
enum Column { T, V, VY, OMEGA, UNTIL, HEADING, PATH, SIDE, STEADY, NUM_COLUMNS };
constexpr int NUM_INTERVALS = 10;  // of the past that weighs in a first-order lag
constexpr double ROUNDING = 1e-12;

struct Tunables {
  double speed_time, turn_time, bridged, validity, mean, steady, min_steady_speed, moving_speed, sideways_share, max_lag,
      bend;
  int num_bends;
};

struct Motion {
  Vector3 delta = Vector3::Zero();
  Matrix3 covariance = Matrix3::Zero();
  Jacobian jacobian = Jacobian::Zero();
  double path = 0.0, turned = 0.0;
};

struct Settled {
  double v = 0.0, vy = 0.0, omega = 0.0, by_v = 0.0, by_vy = 0.0, by_omega = 0.0;
  bool moves() const { return v || vy || omega; }
};

struct Piece {
  double shift, swing, dt, v, vy, omega, steady;
  bool moves() const { return v || vy || omega; }
};

class Twists {
 public:
  Twists(const double *rows, int64_t size, int64_t width, double steady_s, double mean_s)
      : rows_(rows), size_(size), width_(width), steady_s_(steady_s), mean_s_(mean_s) {}

  int64_t size() const { return size_; }
  double at(int64_t k, Column column) const { return rows_[k * width_ + column]; }

  // The number of twists before a time, and at it as well if `inclusive`.
  int64_t before(double t, bool inclusive) const {
    int64_t low = 0, high = size_;
    while (low < high) {
      const int64_t middle = (low + high) / 2;
      const double stamp = at(middle, T);
      if (stamp < t || (inclusive && stamp == t)) low = middle + 1; else high = middle;
    }
    return low;
  }

  // A path (PATH, SIDE) up to a time, at a speed (V, VY).
  double path(double t, Column path, Column speed) const {
    if (!size_) return 0.0;
    const int64_t k = std::max<int64_t>(before(t, true) - 1, 0);
    return at(k, path) + at(k, speed) * std::max(std::min(t, at(k, UNTIL)) - at(k, T), 0.0);
  }

  double steady_speed(double t, Column path = PATH, Column speed = V) const {
    return (this->path(t, path, speed) - this->path(t - steady_s_, path, speed)) / steady_s_;
  }

  bool strafes(double t, double moving_speed, double share) const {
    const double side = std::abs(steady_speed(t, SIDE, VY));
    return side > moving_speed && side > share * std::abs(steady_speed(t));
  }

  // The robot's twist, which follows the odometry as a first-order lag, and its slope.
  Settled settled(double t, double time_constant) const {
    if (!size_) return {};
    const double lag = std::max(time_constant, 0.5 * mean_s_);
    std::array<double, NUM_INTERVALS + 1> times, paths, sides, headings;
    int64_t k = std::max<int64_t>(before(t, true) - 1, 0);
    for (int i = 0; i <= NUM_INTERVALS; i++) {
      times[i] = -std::log1p(-i / (NUM_INTERVALS + 0.5));
      const double time = t - lag * times[i];
      while (k && at(k, T) > time) k--;
      double dt = time - at(k, T);  // the first twist counts before its stamp, too
      if (dt > 0.0) dt = std::max(std::min(dt, at(k, UNTIL) - at(k, T)), 0.0);
      paths[i] = at(k, PATH) + at(k, V) * dt, sides[i] = at(k, SIDE) + at(k, VY) * dt;
      headings[i] = at(k, HEADING) + at(k, OMEGA) * dt;
    }
    std::array<double, NUM_INTERVALS> slopes;
    double sum = 0.0;
    for (int i = 0; i < NUM_INTERVALS; i++) {
      slopes[i] = (1.0 + times[i]) * std::exp(-times[i]) - (1.0 + times[i + 1]) * std::exp(-times[i + 1]);
      sum += slopes[i];
    }
    Settled found;
    for (int i = 0; i < NUM_INTERVALS; i++) {
      const double over = lag * (times[i + 1] - times[i]), slope = slopes[i] / sum;
      const double v = (paths[i] - paths[i + 1]) / over, vy = (sides[i] - sides[i + 1]) / over;
      const double omega = (headings[i] - headings[i + 1]) / over;
      found.v += v / NUM_INTERVALS, found.vy += vy / NUM_INTERVALS, found.omega += omega / NUM_INTERVALS;
      found.by_v += slope * v, found.by_vy += slope * vy, found.by_omega += slope * omega;
    }
    return found;
  }

 private:
  const double *rows_;
  int64_t size_, width_;
  double steady_s_, mean_s_;
};

// Growth of an integrated Ornstein-Uhlenbeck process of unit variance.
double variance_growth(double after, double time, double lasts) {
  return 2.0 * lasts * (time + lasts * std::exp(-after / lasts) * std::expm1(-time / lasts));
}

struct Usual {
  double speed, turn_rate;
  void add_growth(double silent, double begin, double end, const Tunables &s, Piece &piece) const {
    if (end <= begin) return;
    const double after = std::max(begin - silent, 0.0), time = end - begin;
    piece.shift += speed * speed * variance_growth(after, time, s.speed_time);
    piece.swing += turn_rate * turn_rate * variance_growth(after, time, s.turn_time);
  }
};

std::vector<Piece> pieces_of(const Twists &twists, double begin, double end, const Usual &usual,
                             const Tunables &s) {
  const int64_t first = std::max<int64_t>(twists.before(begin, false) - 1, 0), last = twists.before(end, false);
  std::vector<Piece> pieces;
  if (first >= last) {
    Piece none{};
    usual.add_growth(-INFINITY, begin, end, s, none);
    return {none};
  }
  pieces.reserve(last - first);
  for (int64_t k = first; k < last; k++) {
    const double t = twists.at(k, T), silent = twists.at(k, UNTIL);
    const double v = twists.at(k, V), vy = twists.at(k, VY), omega = twists.at(k, OMEGA);
    const double then = k + 1 < last ? twists.at(k + 1, T) : end, start = std::max(t, begin);
    const double known = std::min(std::max(silent - start, 0.0), then - start);
    Piece piece{0.0, 0.0, known, v, vy, omega, 0.0};
    piece.steady = k + 1 < last ? twists.at(k + 1, STEADY) : twists.steady_speed(end);
    if (start + known < then) usual.add_growth(silent, start + known, then, s, piece);
    const double bridged = start + known - std::max(start, t + s.validity);
    if (bridged > 0.0) {
      piece.shift += std::pow(s.bridged * std::hypot(v, vy) * bridged, 2);
      piece.swing += std::pow(s.bridged * omega * bridged, 2);
    }
    pieces.push_back(piece);
  }
  if (twists.at(first, T) > begin) usual.add_growth(-INFINITY, begin, twists.at(first, T), s, pieces[0]);
  return pieces;
}

// Symmetric and positive, with rounding below zero clipped: geometry/covariance.py.
Matrix3 positive(const Matrix3 &computed, double scale) {
  Matrix3 c = 0.5 * (computed + computed.transpose());
  const double trace = c.trace();
  if (c(0, 0) > 0.0 && trace < INFINITY) {
    const double y = c(1, 1) - c(0, 1) * c(0, 1) / c(0, 0), cross = c(1, 2) - c(0, 1) * c(0, 2) / c(0, 0);
    if (y > 0.0 && c(2, 2) - c(0, 2) * c(0, 2) / c(0, 0) - cross * cross / y > 0.0) return c;
  }
  if (c.isZero(0.0)) return c;
  if (!c.allFinite()) throw std::domain_error("the covariance of a composed motion is not finite");
  Eigen::SelfAdjointEigenSolver<Matrix3> solver(c);
  const Vector3 values = solver.eigenvalues();
  if (values[0] < -ROUNDING * std::max(scale, values[2]))
    throw std::domain_error("the covariance of a composed motion has a negative eigenvalue");
  const Matrix3 root = solver.eigenvectors() * values.cwiseMax(0.0).cwiseSqrt().asDiagonal();
  c = root * root.transpose();
  return 0.5 * (c + c.transpose());
}

Motion composed(const Motion &a, const Motion &b) {
  const Composition both(a.delta, b.delta);
  const Matrix3 &by_a = both.by_a, &by_b = both.by_b;
  Motion to;
  to.delta = both.pose;
  const double lever = by_a(0, 2) * by_a(0, 2) + by_a(1, 2) * by_a(1, 2);
  to.covariance = positive(by_a * a.covariance * by_a.transpose() + by_b * b.covariance * by_b.transpose(),
                           (1.0 + lever) * a.covariance.trace() + b.covariance.trace());
  to.jacobian = by_a * a.jacobian + by_b * b.jacobian;
  to.path = a.path + b.path, to.turned = a.turned + b.turned;
  return to;
}

double sinc(double half) { return half ? std::sin(half) / half : 1.0; }

double turn_rate(double omega, bool moves, const double *calibration) {
  return moves ? (1.0 + calibration[TURN_SCALE]) * omega + calibration[TURN_BIAS] : 0.0;
}

// The commanded motion that the robot still has to make, forward or backward by sign.
Motion outstanding(const Settled &end, const double *calibration, double sign) {
  const double lag = calibration[TIME_CONSTANT], size = 1.0 + calibration[SPEED_SCALE];
  const double aside = size * (1.0 + calibration[SIDEWAYS_SCALE]);
  const double half = 0.5 * turn_rate(end.omega, end.moves(), calibration) * sign * lag, heading = 2.0 * half;
  const double chord = size * end.v * sign * lag * sinc(half), left = aside * end.vy * sign * lag * sinc(half);
  const double ahead = chord * std::cos(half), side = left * std::cos(half);
  Motion motion;
  motion.delta << ahead - left * std::sin(half), chord * std::sin(half) + side, heading;
  const Vector3 by_turn(-ahead * heading / 3.0 - 0.5 * side, 0.5 * ahead - side * heading / 3.0, 1.0);
  motion.jacobian.col(TURN_SCALE) = by_turn * (sign * lag * end.omega);
  motion.jacobian.col(TURN_BIAS) = by_turn * (sign * lag);
  motion.jacobian.col(SIDEWAYS_SCALE) << -left * std::sin(half) * size / aside, side * size / aside, 0.0;
  const double c = std::cos(heading), s = std::sin(heading), by_ahead = size * end.by_v;
  const double by_side = aside * end.by_vy;
  const double by_rate = turn_rate(end.by_omega, end.moves(), calibration);
  motion.jacobian.col(TIME_CONSTANT) << c * by_ahead - s * by_side, s * by_ahead + c * by_side, by_rate;
  motion.jacobian.col(TIME_CONSTANT) *= sign;
  return motion;
}

struct Chord {
  double x, y, c, s, slips;
};

Motion commanded(const std::vector<Piece> &pieces, const double *calibration, const double *rates,
                 double straightest, const Tunables &tunables, Vector &by_bend) {
  const double slip = calibration[TURN_SLIP], size = 1.0 + calibration[SPEED_SCALE];
  const double aside = size * (1.0 + calibration[SIDEWAYS_SCALE]);
  double x = 0.0, y = 0.0, psi = 0.0;
  Motion motion;
  std::vector<Chord> chords;
  chords.reserve(pieces.size());
  for (const Piece &p : pieces) {
    const double spin = std::abs(p.omega), rate = turn_rate(p.omega, p.moves(), calibration);
    const double ahead = std::abs(p.steady) > tunables.min_steady_speed ? p.steady : p.v;
    const double slips = p.v ? std::copysign(spin, ahead) - p.steady * straightest : 0.0;
    const double speed = size * (p.v - slip * slips), half = 0.5 * rate * p.dt;
    const double c = std::cos(psi + half), s = std::sin(psi + half);
    const double chord = speed * p.dt * sinc(half), left = aside * p.vy * p.dt * sinc(half);
    motion.jacobian(0, SIDEWAYS_SCALE) -= left * s, motion.jacobian(1, SIDEWAYS_SCALE) += left * c;
    const double dx = chord * c - left * s, dy = chord * s + left * c;
    chords.push_back({x + 0.5 * dx, y + 0.5 * dy, c, s, size * slips});
    x += dx, y += dy, psi += 2.0 * half;
    motion.path += std::hypot(p.v, p.vy) * p.dt, motion.turned += 2.0 * std::abs(half);
    const double bend = spin / std::max(std::abs(p.steady), 1e-6) / tunables.bend;
    by_bend[bend < tunables.num_bends ? int(bend) : tunables.num_bends - 1] += std::abs(p.v) * p.dt;
  }
  motion.delta << x, y, psi;
  motion.jacobian.col(SIDEWAYS_SCALE) *= size / aside;
  Matrix3 &cov = motion.covariance;
  Jacobian &j = motion.jacobian;
  for (size_t k = 0; k < pieces.size(); k++) {
    const Piece &p = pieces[k];
    const Chord &q = chords[k];
    const double steady = p.moves() ? p.dt : 0.0, speed = std::hypot(p.v, p.vy), spin = std::abs(p.omega);
    double along = steady * (rates[0] + rates[1] * speed + rates[2] * spin) + p.shift;
    double across = steady * (rates[3] + rates[4] * speed + rates[5] * spin) + p.shift;
    const double heading = steady * (rates[6] + rates[7] * speed + rates[8] * spin) + p.swing;
    const double dx = q.y - y, dy = x - q.x;
    // The direction of the motion is the heading, unless the robot moves sideways.
    double c = q.c, s = q.s;
    if (p.vy) {
      if (rates[3]) {
        const double own = steady * rates[0], other = steady * rates[3];
        along -= own, across -= other;
        cov(0, 0) += c * c * own + s * s * other;
        cov(0, 1) += c * s * (own - other);
        cov(1, 1) += s * s * own + c * c * other;
      }
      c = (q.c * p.v - q.s * p.vy) / speed, s = (q.s * p.v + q.c * p.vy) / speed;
    }
    cov(0, 0) += dx * dx * heading + c * c * along + s * s * across;
    cov(0, 1) += dx * dy * heading + c * s * (along - across);
    cov(1, 1) += dy * dy * heading + s * s * along + c * c * across;
    cov(0, 2) += dx * heading, cov(1, 2) += dy * heading, cov(2, 2) += heading;
    const Vector3 by_turn(dx, dy, 1.0);
    j.col(TURN_SCALE) += by_turn * (p.omega * p.dt);
    j.col(TURN_BIAS) += by_turn * steady;
    j(0, TURN_SLIP) -= q.c * q.slips * p.dt, j(1, TURN_SLIP) -= q.s * q.slips * p.dt;
  }
  cov(1, 0) = cov(0, 1), cov(2, 0) = cov(0, 2), cov(2, 1) = cov(1, 2);
  return motion;
}

nb::tuple preintegrate(In rows, double begin, double end, In calibration, In rates, double usual_speed,
                       double usual_turn_rate, double straightest, const Tunables &s) {
  require_shape("calibration", calibration, {NC}), require_shape("rates", rates, {3, 3});
  if (rows.ndim() != 2 || rows.shape(1) < NUM_COLUMNS) throw nb::value_error("twists has another shape");
  const double *cal = calibration.data();
  const double delay = std::min(std::max(cal[DELAY], -s.max_lag), s.max_lag);
  const double constant = std::min(cal[TIME_CONSTANT], s.max_lag);
  begin -= delay, end -= delay;
  const Twists twists(rows.data(), rows.shape(0), rows.shape(1), s.steady, s.mean);
  const double known = twists.size() ? std::max(begin, twists.at(0, T)) : end;
  const Settled first = twists.settled(known, constant), last = twists.settled(end, constant);
  const std::vector<Piece> pieces = pieces_of(twists, begin, end, {usual_speed, usual_turn_rate}, s);
  Vector by_bend = Vector::Zero(s.num_bends);
  Motion motion = commanded(pieces, cal, rates.data(), straightest, s, by_bend);
  motion = composed(composed(outstanding(first, cal, 1.0), motion), outstanding(last, cal, -1.0));
  const double size = 1.0 + cal[SPEED_SCALE];
  motion.jacobian.block<2, 1>(0, SPEED_SCALE) = motion.delta.head<2>() / size;
  if (!twists.strafes(end, s.moving_speed, s.sideways_share)) motion.jacobian.col(SIDEWAYS_SCALE).setZero();
  const double aside = size * (1.0 + cal[SIDEWAYS_SCALE]);
  const double c = std::cos(motion.delta[2]), sn = std::sin(motion.delta[2]);
  const double v0 = size * first.v, vy0 = aside * first.vy, rate0 = turn_rate(first.omega, first.moves(), cal);
  const double v1 = size * last.v, vy1 = aside * last.vy, rate1 = turn_rate(last.omega, last.moves(), cal);
  motion.jacobian.col(DELAY) << v0 - rate0 * motion.delta[1] - (c * v1 - sn * vy1),
      vy0 + rate0 * motion.delta[0] - (sn * v1 + c * vy1), rate0 - rate1;
  double moving = 0.0;
  for (const Piece &p : pieces)
    if (p.moves()) moving += p.dt;
  return nb::make_tuple(array_of(motion.delta, {3}), array_of(motion.covariance, {3, 3}),
                        array_of(motion.jacobian, {3, size_t(NC)}), motion.path, motion.turned,
                        array_of(by_bend, {size_t(s.num_bends)}), moving);
}

}  // namespace

}  // namespace homeward

void bind_motion(nanobind::module_ &m) {
  using namespace homeward;
  nb::class_<Tunables>(m, "MotionTunables")
      .def(nb::init<double, double, double, double, double, double, double, double, double, double, double, int>(),
           nb::arg("speed_time"), nb::arg("turn_time"), nb::arg("bridged"), nb::arg("validity"), nb::arg("mean"),
           nb::arg("steady"), nb::arg("min_steady_speed"), nb::arg("moving_speed"), nb::arg("sideways_share"),
           nb::arg("max_lag"), nb::arg("bend"), nb::arg("num_bends"));
  m.def("preintegrate", &preintegrate, nb::arg("twists").noconvert(), nb::arg("begin"), nb::arg("end"),
        nb::arg("calibration").noconvert(), nb::arg("rates").noconvert(), nb::arg("usual_speed"),
        nb::arg("usual_turn_rate"), nb::arg("straightest"), nb::arg("tunables"));
}

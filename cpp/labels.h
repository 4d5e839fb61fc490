// Labels of items, inlier or outlier: the text to read is reference/labels.py.
#pragma once

#include <algorithm>

#include "algebra.h"

namespace homeward {

constexpr double PI = 3.14159265358979323846, TWO_PI = 2.0 * PI;
const double LOG_TWO_PI = std::log(TWO_PI);

inline double log_add(double a, double b) {
  const double low = std::min(a, b), high = std::max(a, b);
  return low == -INFINITY ? high : high + std::log1p(std::exp(low - high));
}

inline double log_inlier(double off, double variance) {
  variance = std::max(variance, 1e-12);
  return variance > TWO_PI ? -LOG_TWO_PI : -0.5 * off * off / variance - 0.5 * std::log(TWO_PI * variance);
}

using Labels = Eigen::Matrix<bool, Eigen::Dynamic, 1>;

// log_labels(): the log prior of labels of k items, of which some are on bodies.
class LabelPrior {
 public:
  LabelPrior(const Flags &members, const double *one_body, const Vector &wrong, const double *more, double upheaval)
      : k(wrong.size()), b(members.shape(0)), members_(members.data()), upheaval_(upheaval), gain_(k), size_(Vector::Zero(b)),
        separate_(b), one_(b), stayed_(b, 2), moved_(b, 2) {
    for (size_t i = 0; i < k; i++) {
      const double moves = std::log(wrong[i]);
      all_moved_ += moves, gain_[i] = std::log1p(-wrong[i]) - moves;
    }
    for (size_t j = 0; j < b; j++) {
      double share = 0.0, stays = 0.0, moves = 0.0;
      for (size_t i = 0; i < k; i++) {
        if (!is_member(j, i)) continue;
        size_[j]++, share += wrong[i], stays += std::log1p(-wrong[i]), moves += std::log(wrong[i]);
      }
      share /= size_[j], separate_[j] = std::log1p(-one_body[j]), one_[j] = std::log(one_body[j]);
      stayed_(j, 0) = std::log1p(-share) - stays, moved_(j, 0) = std::log(share) - moves + more[j];
      const double halves = (1.0 - size_[j]) * std::log(0.5);  // after an upheaval
      stayed_(j, 1) = halves, moved_(j, 1) = halves + more[j];
    }
  }

  double operator()(const bool *right) const {
    const size_t number = std::count(right, right + k, true);
    double logs[2] = {all_moved_, std::lgamma(1.0 + number) + std::lgamma(1.0 + k - number) - std::lgamma(2.0 + k)};
    for (size_t i = 0; i < k; i++)
      if (right[i]) logs[0] += gain_[i];
    for (size_t j = 0; j < b; j++) {
      double inside = 0.0;
      for (size_t i = 0; i < k; i++) inside += is_member(j, i) && right[i];
      for (int w = 0; w < 2; w++) {
        const double as_one = inside == size_[j] ? stayed_(j, w) : inside == 0.0 ? moved_(j, w) : -INFINITY;
        logs[w] += log_add(separate_[j], one_[j] + as_one);
      }
    }
    return log_add(std::log1p(-upheaval_) + logs[0], std::log(upheaval_) + logs[1]);
  }

 private:
  bool is_member(size_t j, size_t i) const { return members_[j * k + i]; }
  const size_t k, b;
  const bool *members_;
  const double upheaval_;
  double all_moved_ = 0.0;
  Vector gain_, size_, separate_, one_;
  Fixed<Eigen::Dynamic, 2> stayed_, moved_;  // by the rule, and after an upheaval
};

}  // namespace homeward

// Additional unknowns of a window: the text to read is reference/extension.py.
#include "equations.h"

namespace homeward {
namespace {

// reference.extension.extend(), of the arrays of Linearised and Unknown. Sightings and motions that depend on few of
// the unknowns are usual, so that zeros at the end of their rows are skipped.
nb::tuple extend(Out own, Out next, Out shared, Out common, Out slope, Out common_slope, In residual, In jacobian,
                 Numbers poses_of, Numbers landmarks_of, In error, In by_state, In information, In weight,
                 In by_bearing, Numbers block, In prior, In by_motion, bool with_absorbed) {
  const Equations e(own, next, shared, common, slope, common_slope);
  const size_t m = residual.size(), w = e.w, n = (e.a - NC) / 2, k = prior.size();
  const size_t j = by_bearing.ndim() == 2 ? by_bearing.shape(1) : 0;
  require_shape("jacobian", jacobian, {m, HEAD + 2}), require_shape("pose", poses_of, {m});
  require_shape("landmark", landmarks_of, {m}), require_shape("by_bearing", by_bearing, {m, j});
  require_shape("block", block, {m}), require_shape("error", error, {w - 1, 3});
  require_shape("by_state", by_state, {w - 1, 3, 6 + NC}), require_shape("weight", weight, {w - 1});
  require_shape("information", information, {w - 1, 3, 3});
  Matrix pull = Matrix::Zero(3 * w + e.a, k), found = Eigen::Map<const Vector>(prior.data(), k).asDiagonal();
  Vector gradient = Vector::Zero(k);
  const size_t calibration = 3 * w, landmarks = calibration + NC;
  for (size_t i = 0; i < m; i++) {
    const size_t pose = size_t(poses_of.data()[i]), mark = size_t(landmarks_of.data()[i]);
    const size_t at = block.data()[i] < 0 ? 0 : j * size_t(block.data()[i]);
    if (pose >= w || mark >= n || at + j > k) throw nb::index_error("a sighting of another window");
    const double *by = by_bearing.data() + j * i, *row = jacobian.data() + (HEAD + 2) * i;
    size_t used = block.data()[i] < 0 ? 0 : j;
    while (used && by[used - 1] == 0.0) used--;
    const auto add = [&](double *to, double factor) {
      for (size_t c = 0; c < used; c++) to[at + c] += factor * by[c];
    };
    for (int c = 0; c < 3; c++) add(&pull(3 * pose + c, 0), row[c]);
    for (int c = 0; c < NC; c++) add(&pull(calibration + c, 0), row[3 + c]);
    for (int c = 0; c < 2; c++) add(&pull(landmarks + 2 * mark + c, 0), row[HEAD + c]);
    for (size_t c = 0; c < used; c++) add(&found(at + c, 0), by[c]);
    add(gradient.data(), residual.data()[i]);
  }
  if (by_motion.is_valid()) {
    require_shape("by_motion", by_motion, {w - 1, 3, k});
    for (size_t i = 0; i + 1 < w; i++) {
      const Eigen::Map<const Matrix> by(by_motion.data() + 3 * k * i, 3, k);
      if (by.isZero(0.0)) continue;
      const Eigen::Map<const Fixed<3, 6 + NC>> states(by_state.data() + 3 * (6 + NC) * i);
      const Matrix weighted = weight.data()[i] * Eigen::Map<const Matrix3>(information.data() + 9 * i) * by;
      pull.middleRows(3 * i, 6) += states.leftCols<6>().transpose() * weighted;
      pull.middleRows(calibration, NC) += states.rightCols<NC>().transpose() * weighted;
      found.noalias() += by.transpose() * weighted;
      gradient += weighted.transpose() * Eigen::Map<const Vector3>(error.data() + 3 * i);
    }
  }
  const Elimination eliminated(e);
  eliminated.whiten(pull);
  found.selfadjointView<Eigen::Lower>().rankUpdate(pull.transpose(), -1.0);
  found.triangularView<Eigen::StrictlyUpper>() = found.transpose();
  gradient.noalias() -= pull.transpose() * eliminated.whitened;
  if (!found.allFinite() || !gradient.allFinite()) throw std::domain_error("no finite information");
  eliminated.substitute(pull, with_absorbed);
  nb::tuple absorbed;
  if (with_absorbed) {
    Matrix bearings(m, k), motions(3 * (w - 1), k);
    const auto shared_steps = pull.middleRows<NC>(calibration);
    for (size_t i = 0; i < m; i++) {
      const Eigen::Map<const Fixed<HEAD + 2, 1>> row(jacobian.data() + (HEAD + 2) * i);
      bearings.row(i) = row.head<3>().transpose() * pull.middleRows<3>(3 * poses_of.data()[i]);
      bearings.row(i) += row.segment<NC>(3).transpose() * shared_steps;
      bearings.row(i) += row.tail<2>().transpose() * pull.middleRows<2>(landmarks + 2 * landmarks_of.data()[i]);
    }
    for (size_t i = 0; i + 1 < w; i++) {
      const Eigen::Map<const Fixed<3, 6 + NC>> states(by_state.data() + 3 * (6 + NC) * i);
      motions.middleRows<3>(3 * i) = states.leftCols<6>() * pull.middleRows<6>(3 * i);
      motions.middleRows<3>(3 * i) += states.rightCols<NC>() * shared_steps;
    }
    absorbed = nb::make_tuple(array_of(bearings, {m, k}), array_of(motions, {w - 1, 3, k}));
  }
  return nb::make_tuple(array_of(found, {k, k}), array_of(Matrix(gradient), {k}),
                        array_of(pull.bottomRows(e.a), {e.a, k}), absorbed);
}

}  // namespace
}  // namespace homeward

void bind_extension(nanobind::module_ &m) {
  using namespace homeward;
  const auto array = [](const char *name) { return nb::arg(name).noconvert(); };
  m.def("extend", &extend, array("own"), array("next"), array("shared"), array("common"), array("slope"),
        array("common_slope"), array("residual"), array("jacobian"), array("pose"), array("landmark"), array("error"),
        array("by_state"), array("information"), array("weight"), array("by_bearing"), array("block"), array("prior"),
        array("by_motion").none(), nb::arg("with_absorbed"));
}

// The compiled core: C++ versions of loops that the package also has in NumPy.
#include <nanobind/nanobind.h>

// One function for each file of functions; CMakeLists.txt lists the files.
void bind_align(nanobind::module_ &m);
void bind_extension(nanobind::module_ &m);
void bind_factors(nanobind::module_ &m);
void bind_frame(nanobind::module_ &m);
void bind_motion(nanobind::module_ &m);
void bind_refine(nanobind::module_ &m);
void bind_sets(nanobind::module_ &m);
void bind_window(nanobind::module_ &m);

// Increase it, and that of core.py, with each change of a signature: an editable installation may have a
// module that is older than its Python.
constexpr int INTERFACE = 5;

NB_MODULE(_core, m) {
  m.attr("INTERFACE") = INTERFACE;
  bind_align(m);
  bind_extension(m);
  bind_factors(m);
  bind_frame(m);
  bind_motion(m);
  bind_refine(m);
  bind_sets(m);
  bind_window(m);
}

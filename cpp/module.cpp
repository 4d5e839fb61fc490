// The compiled core: C++ versions of loops that the package also has in NumPy.
#include <nanobind/nanobind.h>

// One function for each file of functions; CMakeLists.txt lists the files.
void bind_align(nanobind::module_ &m);
void bind_motion(nanobind::module_ &m);
void bind_refine(nanobind::module_ &m);
void bind_window(nanobind::module_ &m);

NB_MODULE(_core, m) {
  bind_align(m);
  bind_motion(m);
  bind_refine(m);
  bind_window(m);
}

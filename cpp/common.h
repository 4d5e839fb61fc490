// What the files of functions share.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <initializer_list>
#include <string>

namespace homeward {

namespace nb = nanobind;

// Array argument, which must have this type and be contiguous: anything else is a TypeError.
// Bind it with nb::arg(...).noconvert(): nanobind would otherwise pass a converted copy, and results
// written to that copy would be lost.
template <typename T>
using Array = nb::ndarray<T, nb::c_contig, nb::device::cpu>;

// Raise ValueError unless an array has this shape.
template <typename T>
void require_shape(const char *name, const Array<T> &array, std::initializer_list<size_t> shape) {
  bool is_equal = array.ndim() == shape.size();
  size_t k = 0;
  for (size_t size : shape) {
    is_equal = is_equal && array.shape(k) == size;
    k++;
  }
  if (!is_equal) throw nb::value_error((std::string(name) + " has another shape").c_str());
}

inline double clipped(double value, double low, double high) {
  return value > low ? (value < high ? value : high) : low;  // NaN: low
}

}  // namespace homeward

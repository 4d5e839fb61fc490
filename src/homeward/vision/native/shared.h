/* The camera front-end's innermost loops; see compiled.py, which puts the files of this folder
 * together. Matrices are row-major. Each function does what the Python function that calls it does
 * with NumPy, and stands for it. */

#include <math.h>
#include <stdint.h>
#include <string.h>

static double clipped(double value, double least, double most) {
  return value > least ? (value < most ? value : most) : least; /* NaN: the least */
}

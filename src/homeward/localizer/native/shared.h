/* The localiser's innermost loops; see compiled.py, which puts the files of this folder together.
 * Matrices are row-major, all numbers doubles. Each function does what the Python function that
 * calls it does with NumPy, and stands for it. Here is what the others share. */

#include <math.h>
#include <string.h>

#define NC 7                     /* calibration */
#define LANDMARK 1
#define BEARING 2
#define SIGMA 3
#define OFFSET 5
#define OFFSET_JACOBIAN 8
#define COLUMNS (8 + 3 * NC)     /* of a sighting */
#define HEAD (3 + NC)            /* pose and calibration */
#define UNKNOWNS (HEAD + 2)      /* a sighting's: those, and the landmark */
#define FREE 0
#define NOISE 3
#define BY_CALIBRATION 12
#define STEP (12 + 3 * NC)       /* columns of a step */

/* Runs side by side: one. It is what a library is asked to prove that it can be loaded. */
int homeward_lanes(void) { return 1; }

static double wrapped(double angle) {
  const double pi = 3.14159265358979323846;
  return angle - 2.0 * pi * ceil((angle - pi) / (2.0 * pi));
}

/* Inverse of a symmetric positive definite 3x3 matrix, by its Cholesky root; 0, or 1 if it is not
 * that. */
static int invert(const double *m, double *inverse) {
  const double a = sqrt(m[0]), b = m[3] / a, d = m[6] / a;
  const double c = sqrt(m[4] - b * b), e = (m[7] - d * b) / c, f = sqrt(m[8] - d * d - e * e);
  const double root[3][3] = {{1.0 / a, 0.0, 0.0},
                             {-b / (a * c), 1.0 / c, 0.0},
                             {(b * e - c * d) / (a * c * f), -e / (c * f), 1.0 / f}};
  for (int i = 0; i < 3; i++)
    for (int q = 0; q < 3; q++)
      inverse[3 * i + q] =
          root[0][i] * root[0][q] + root[1][i] * root[1][q] + root[2][i] * root[2][q];
  return !(a > 0.0 && c > 0.0 && f > 0.0 && isfinite(inverse[0]) && isfinite(inverse[8]));
}

static double log_determinant(const double *m) {
  return log(m[0] * (m[4] * m[8] - m[5] * m[7]) - m[1] * (m[3] * m[8] - m[5] * m[6]) +
             m[2] * (m[3] * m[7] - m[4] * m[6]));
}

/* Lower Cholesky root in the place of a matrix (m, m); 0, or 1 if it is not positive definite. */
static int root(long m, double *matrix) {
  for (long i = 0; i < m; i++)
    for (long q = 0; q <= i; q++) {
      double sum = matrix[m * i + q];
      for (long k = 0; k < q; k++) sum -= matrix[m * i + k] * matrix[m * q + k];
      if (i == q && !(sum > 0.0)) return 1;
      matrix[m * i + q] = i == q ? sqrt(sum) : sum / matrix[m * q + q];
    }
  return 0;
}

/* Measured minus expected bearing of one sighting, and the Jacobian of the expected one. */
static double residual_of(const double *pose, double c, double s, const double *calibration,
                          const double *position, const double *row, double *jacobian) {
  double arm[3];
  for (int i = 0; i < 3; i++) {
    arm[i] = row[OFFSET + i];
    for (int k = 0; k < NC; k++) arm[i] += row[OFFSET_JACOBIAN + NC * i + k] * calibration[k];
  }
  const double ax = c * arm[0] - s * arm[1], ay = s * arm[0] + c * arm[1];
  const double dx = position[0] - pose[0] - ax, dy = position[1] - pose[1] - ay;
  const double square = fmax(dx * dx + dy * dy, 1e-6), gx = -dy / square, gy = dx / square;
  const double by_offset[3] = {-(gx * c + gy * s), gx * s - gy * c, -1.0};
  jacobian[0] = -gx;
  jacobian[1] = -gy;
  jacobian[2] = gx * ay - gy * ax - 1.0;
  for (int k = 0; k < NC; k++) {
    jacobian[3 + k] = 0.0;
    for (int i = 0; i < 3; i++)
      jacobian[3 + k] += by_offset[i] * row[OFFSET_JACOBIAN + NC * i + k];
  }
  jacobian[3 + NC] = gx;
  jacobian[4 + NC] = gy;
  return wrapped(row[BEARING] - (atan2(dy, dx) - pose[2] - arm[2]));
}

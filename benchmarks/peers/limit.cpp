// The EKF by hand, as the limit: q fixed, structure of every Jacobian used, sines and cosines of
// differences by angle sums, scalar updates, the symmetric half of P alone.
#include <cmath>
#include <cstdint>
#include <cstring>

constexpr int q = 7, n = 3 + q;

struct Numbers {
  double dt, guard2, q_v, q_omega, walk, variance;
  double stored[q];
};

struct Stage {         // slopes and their derivatives by (R, theta, alpha), own bearing, (v, omega)
  double f[n], s[n][3], own[q], u[n][2];
};

static void slopes(const double *x, double v, double omega, double h, const Stage &before,
                   const double *home_s, const double *home_c, double guard2, Stage &after) {
  double angle[16] = {}, sine[16], cosine[16];
  for (int i = 0; i < n - 1; i++) angle[i] = x[i + 1];
  for (int i = 0; i < 16; i++) sine[i] = std::sin(angle[i]);
  for (int i = 0; i < 16; i++) cosine[i] = std::cos(angle[i]);
  const double R = x[0], st = sine[0], ct = cosine[0], sa = sine[1], ca = cosine[1];
  const double s = sa * ct - ca * st, c = ca * ct + sa * st;
  const double inv = 1.0 / (R * R + guard2), g = R * inv, g_R = (guard2 - R * R) * inv * inv;
  double A[3][3] = {{0, v * s, -v * s}, {v * s * g_R, -v * c * g, v * c * g}, {0, 0, 0}};
  after.f[0] = v * c, after.f[1] = v * s * g, after.f[2] = omega;
  double M[3][3], U[3][2];  // I + h S and h U of the stage before, their upper rows
  for (int r = 0; r < 3; r++) {
    for (int k = 0; k < 3; k++) M[r][k] = (r == k) + h * before.s[r][k];
    for (int k = 0; k < 2; k++) U[r][k] = h * before.u[r][k];
  }
  for (int r = 0; r < 3; r++) {
    for (int k = 0; k < 3; k++)
      after.s[r][k] = A[r][0] * M[0][k] + A[r][1] * M[1][k] + A[r][2] * M[2][k];
    for (int k = 0; k < 2; k++)
      after.u[r][k] = A[r][0] * U[0][k] + A[r][1] * U[1][k] + A[r][2] * U[2][k];
  }
  after.u[0][0] += c, after.u[1][0] += s * g, after.u[2][1] += 1.0;
  for (int i = 0; i < q; i++) {
    const double sb = sine[2 + i], cb = cosine[2 + i], sh = home_s[i], ch = home_c[i];
    const double sphi = sb * ca + cb * sa, cphi = cb * ca - sb * sa;
    const double sp = sh * cphi - ch * sphi, cp = ch * cphi + sh * sphi;
    const double sl = sh * ct - ch * st, cl = ch * ct + sh * st;
    const double w = R * sl, iw = 1.0 / (w * w + guard2);
    const double near = w * iw, near_w = (guard2 - w * w) * iw * iw;
    const double B0 = -v * sb * sp * near_w * sl, B1 = v * sb * sp * near_w * R * cl;
    const double B2 = v * sb * cp * near, D = -v * (cb * sp - sb * cp) * near;
    const double by_v = -sb * sp * near;
    after.f[3 + i] = v * by_v - omega;
    for (int k = 0; k < 3; k++)
      after.s[3 + i][k] =
          B0 * M[0][k] + B1 * M[1][k] + B2 * M[2][k] + D * h * before.s[3 + i][k];
    after.own[i] = D * (1.0 + h * before.own[i]);
    for (int k = 0; k < 2; k++)
      after.u[3 + i][k] = B0 * U[0][k] + B1 * U[1][k] + B2 * U[2][k] + D * h * before.u[3 + i][k];
    after.u[3 + i][0] += by_v, after.u[3 + i][1] -= 1.0;
  }
}

static void predict(const Numbers &m, const double *home_s, const double *home_c, double v,
                    double omega, double *x, double P[n][n]) {
  static const double reach[4] = {0, 0.5, 0.5, 1}, weight[4] = {1. / 6, 1. / 3, 1. / 3, 1. / 6};
  Stage stage[2] = {}, mean = {};
  for (int k = 0; k < 4; k++) {
    const Stage &before = stage[k & 1];
    Stage &after = stage[(k + 1) & 1];
    const double h = reach[k] * m.dt, w = weight[k] * m.dt;
    double at[n];
    for (int i = 0; i < n; i++) at[i] = x[i] + h * before.f[i];
    slopes(at, v, omega, h, before, home_s, home_c, m.guard2, after);
    const double *from = &after.f[0];
    double *to = &mean.f[0];
    for (size_t i = 0; i < sizeof(Stage) / sizeof(double); i++) to[i] += w * from[i];
  }
  for (int i = 0; i < n; i++) x[i] += mean.f[i];
  double G[n][3], d[q], H[n][2];
  for (int i = 0; i < n; i++) {
    for (int k = 0; k < 3; k++) G[i][k] = (i == k) + mean.s[i][k];
    H[i][0] = mean.u[i][0], H[i][1] = mean.u[i][1];
  }
  for (int i = 0; i < q; i++) d[i] = 1.0 + mean.own[i];
  // T = P G' restricted to the columns of (R, theta, alpha): T[k] = row k of P times every row of G
  double T[3][n], N[n][n];
  for (int k = 0; k < 3; k++)
    for (int j = 0; j < n; j++) {
      double t = P[k][0] * G[j][0] + P[k][1] * G[j][1] + P[k][2] * G[j][2];
      if (j >= 3) t += P[k][j] * d[j - 3];
      T[k][j] = t;
    }
  for (int i = 0; i < n; i++) {
    const double a = m.q_v * H[i][0], b = m.q_omega * H[i][1];
    for (int j = 0; j <= i; j++)
      N[i][j] = G[i][0] * T[0][j] + G[i][1] * T[1][j] + G[i][2] * T[2][j] + a * H[j][0] +
                b * H[j][1];
    if (i >= 3)
      for (int j = 0; j <= i; j++) {
        double t = P[i][0] * G[j][0] + P[i][1] * G[j][1] + P[i][2] * G[j][2];
        if (j >= 3) t += P[i][j] * d[j - 3];
        N[i][j] += d[i - 3] * t;
      }
    N[i][i] += m.walk;
  }
  for (int i = 0; i < n; i++)
    for (int j = 0; j <= i; j++) P[i][j] = P[j][i] = N[i][j];
}

static void update(const Numbers &m, const double *y, const double *mask, double *x,
                   double P[n][n]) {
  double e[q], before[n], column[n];
  for (int i = 0; i < q; i++) e[i] = y[i] - x[3 + i];
  std::memcpy(before, x, sizeof before);
  for (int i = 0; i < q; i++) {
    if (mask[i] == 0.0) continue;
    const int j = 3 + i;
    const double share = 1.0 / (P[j][j] + m.variance);
    const double push = share * (e[i] - (x[j] - before[j]));
    std::memcpy(column, P[j], sizeof column);
    for (int k = 0; k < n; k++) x[k] += column[k] * push;
    for (int k = 0; k < n; k++) {
      const double c = column[k] * share;
      for (int l = 0; l < n; l++) P[k][l] -= c * column[l];
    }
  }
}

extern "C" void limit(const Numbers *m, int64_t steps, const double *control,
                      const double *bearings, const double *mask, double *x, double *P,
                      double *track) {
  double home_s[q], home_c[q], M[n][n];
  for (int i = 0; i < q; i++) home_s[i] = std::sin(m->stored[i]), home_c[i] = std::cos(m->stored[i]);
  std::memcpy(M, P, sizeof M);
  for (int64_t k = 0; k < steps; k++) {
    predict(*m, home_s, home_c, control[2 * k], control[2 * k + 1], x, M);
    update(*m, bearings + q * k, mask + q * k, x, M);
    std::memcpy(track + n * k, x, n * sizeof(double));
  }
  std::memcpy(P, M, sizeof M);
}

/* Preintegration. */

/* What twists held for pieces of time say of a motion. `pieces` (n, 5): the variances of shift and
 * heading that odometry's silence adds, time with odometry [s], v, omega; `rates` (3, 3): how the
 * variances along, across and of the heading grow, by 1, speed and turn rate. Out: delta (3),
 * covariance (3, 3), jacobian (3, NC), path and sum of turns (2), path by bend (bends). */
void integrate(long n, const double *pieces, const double *calibration, const double *rates,
               double straightest, double bend, long bends, double *delta, double *covariance,
               double *jacobian, double *lengths, double *by_bend) {
  /* First to the end: what a turn swings is what comes after it. */
  memset(delta, 0, 3 * sizeof(double));
  memset(covariance, 0, 9 * sizeof(double));
  memset(jacobian, 0, 3 * NC * sizeof(double));
  memset(lengths, 0, 2 * sizeof(double));
  memset(by_bend, 0, bends * sizeof(double));
  for (int swings = 0; swings < 2; swings++) {
    double x = 0.0, y = 0.0, psi = 0.0, v = 0.0, rate = 0.0;
    for (const double *p = pieces; p < pieces + 5 * n; p += 5) {
      const double dt = p[2], v_said = p[3], omega = p[4];
      const double speed = fabs(v_said), turned = fabs(omega);
      const double moving = v_said != 0.0 || omega != 0.0;
      const double slip = (v_said > 0 ? turned : v_said < 0 ? -turned : 0.0) - v_said * straightest;
      v = v_said - calibration[2] * slip;
      rate = moving * ((1.0 + calibration[0]) * omega + calibration[1]);
      const double turn = rate * dt;
      const double half = 0.5 * turn + 1e-12, chord = v * dt * (sin(half) / half);
      const double c = cos(psi + 0.5 * turn), s = sin(psi + 0.5 * turn);
      psi += turn;
      if (swings) {
        if (p == pieces) { /* what a lag cuts off at the begin */
          jacobian[3] = v - rate * delta[1];
          jacobian[NC + 3] = rate * delta[0];
          jacobian[2 * NC + 3] = rate;
        }
        const double steady = moving * dt;
        const double by_turn[3] = {y + 0.5 * chord * s - delta[1], delta[0] - x - 0.5 * chord * c,
                                   1.0};
        const double by_path[3] = {c, s, 0.0}, by_slip[3] = {-s, c, 0.0};
        double variance[3];
        for (int i = 0; i < 3; i++)
          variance[i] =
              (rates[3 * i] + rates[3 * i + 1] * speed + rates[3 * i + 2] * turned) * steady +
              (i == 2 ? p[1] : p[0]);
        for (int i = 0; i < 3; i++) {
          for (int q = 0; q < 3; q++)
            covariance[3 * i + q] += variance[0] * by_path[i] * by_path[q] +
                                     variance[1] * by_slip[i] * by_slip[q] +
                                     variance[2] * by_turn[i] * by_turn[q];
          jacobian[NC * i] += by_turn[i] * omega * dt;
          jacobian[NC * i + 1] += by_turn[i] * steady;
          jacobian[NC * i + 2] -= by_path[i] * slip * dt;
        }
        lengths[0] += speed * dt;
        lengths[1] += fabs(turn);
        const double class = floor(turned / fmax(speed, 1e-6) / bend);
        by_bend[class < bends - 1 ? (long)class : bends - 1] += speed * dt;
      }
      x += chord * c;
      y += chord * s;
    }
    delta[0] = x;
    delta[1] = y;
    delta[2] = psi;
    if (swings) { /* ... and adds at the end */
      jacobian[3] -= v * cos(psi);
      jacobian[NC + 3] -= v * sin(psi);
      jacobian[2 * NC + 3] -= rate;
    }
  }
}

/* A robot drives an arc among $landmarks landmarks, one of which moved after home was stored. Replace
 * the simulated odometry and camera by your own. Returns 0 if the moved landmark is detected and the
 * position error is below 5 cm. */
#include <math.h>

#include "homeward_ekf.h"

#define MOVED 1U

static homeward_ekf ekf; /* static, so that it needs no stack */
static homeward_resection resection;

static double direction(uint8_t landmark) { return 6.283185307 * landmark / HOMEWARD_LANDMARKS; }

int main(void) {
  const double v = 0.125, omega = 0.25;
  double x = 0.6, y = -0.4, heading = 1.0;
  homeward_settings settings;
  homeward_answer answer;
  homeward_pose pose;
  homeward_defaults(&settings);
  settings.start[0] = (homeward_real)sqrt(x * x + y * y);
  settings.start[1] = (homeward_real)atan2(y, x);
  settings.start[2] = (homeward_real)heading;
  for (uint8_t i = 0; i < 3U; i++) settings.start_sigma[i] = (homeward_real)0.05;
  for (uint8_t i = 0; i < HOMEWARD_LANDMARKS; i++) {
    settings.stored[i] = (homeward_real)(direction(i) + ((i == MOVED) ? 0.4 : 0.0));
  }
  settings.speed_sigma = (homeward_real)0.01;
  settings.turn_sigma = (homeward_real)0.005;
  homeward_ekf_init(&ekf, &settings);
  homeward_resection_init(&resection, &settings);
  for (homeward_time k = 0; k < 200U; k++) { /* 10 s at 20 Hz */
    const homeward_time t = k * 50000U;
    homeward_sighting seen[HOMEWARD_LANDMARKS];
    (void)homeward_ekf_odometry(&ekf, t, (homeward_real)v, (homeward_real)omega);
    (void)homeward_resection_odometry(&resection, t, (homeward_real)v, (homeward_real)omega);
    for (uint8_t i = 0; i < HOMEWARD_LANDMARKS; i++) {
      const double away = 1.5 + (0.05 * i);
      const double dx = (away * cos(direction(i))) - x, dy = (away * sin(direction(i))) - y;
      seen[i].landmark = i;
      seen[i].bearing = (homeward_real)(atan2(dy, dx) - heading);
      seen[i].sigma = 0;
    }
    (void)homeward_ekf_bearings(&ekf, t, seen, HOMEWARD_LANDMARKS);
    (void)homeward_resection_bearings(&resection, t, seen, HOMEWARD_LANDMARKS);
    if ((k % 20U) == 19U) { /* once a second */
      homeward_resection_solve(&resection, &answer);
      homeward_ekf_restart(&ekf, &answer);
    }
    homeward_ekf_pose(&ekf, &pose);
    if (k < 199U) {
      x += v * 0.05 * cos(heading + (omega * 0.025));
      y += v * 0.05 * sin(heading + (omega * 0.025));
      heading += omega * 0.05;
    }
  }
  x -= (double)pose.x;
  y -= (double)pose.y;
  return (sqrt((x * x) + (y * y)) < 0.05 && (ekf.trusted >> MOVED & 1U) == 0U) ? 0 : 1;
}

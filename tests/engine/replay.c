/* Reads samples from standard input, one a line, and writes what the exported filter makes of each:
 * instructions (on the emulated Cortex-M4F alone), status, accepted, state, pose, covariance. */
#include "homeward_ekf.h"

#include <stdio.h>

#ifdef __arm__
/* SysTick counts down at 25 MHz; with -icount shift=6 an instruction takes 64 ns. */
#define SYSTICK ((volatile uint32_t *)0xE000E010)
static uint32_t ticks(void) { return 0xFFFFFFU - SYSTICK[2]; }
static void start_ticking(void) {
  SYSTICK[1] = 0xFFFFFFU;
  SYSTICK[2] = 0;
  SYSTICK[0] = 5;
}
#define INSTRUCTIONS(ticks) (((ticks) & 0xFFFFFFU) * 40U / 64U)
#else
static uint32_t ticks(void) { return 0; }
static void start_ticking(void) {}
#define INSTRUCTIONS(ticks) (ticks)
#endif

static homeward_ekf ekf;

static homeward_real number(void) {
  double x = 0;
  if (scanf("%lf", &x) != 1) x = 0;
  return (homeward_real)x;
}

static void fill(homeward_real *to, unsigned count) {
  for (unsigned i = 0; i < count; i++) to[i] = number();
}

int main(void) {
  homeward_settings settings;
  char kind;
  unsigned long t;
  homeward_defaults(&settings);
  fill(settings.start, 3);
  fill(settings.start_sigma, 3);
  fill(settings.stored, HOMEWARD_LANDMARKS);
  settings.camera_yaw = number();
  settings.bearing_sigma = number();
  settings.speed_sigma = number();
  settings.turn_sigma = number();
  homeward_ekf_init(&ekf, &settings);
  start_ticking();
  while (scanf(" %c %lu", &kind, &t) == 2) {
    homeward_sighting seen[64] = {{0}};
    homeward_status status;
    homeward_pose pose;
    uint32_t took;
    if (kind == 'o') {
      const homeward_real v = number(), omega = number();
      took = ticks();
      status = homeward_ekf_odometry(&ekf, (uint32_t)t, v, omega);
      took = ticks() - took;
    } else {
      const unsigned count = (unsigned)number();
      for (unsigned i = 0; i < count; i++) {
        seen[i].landmark = (uint8_t)number();
        seen[i].bearing = number();
        seen[i].sigma = number();
      }
      took = ticks();
      status = homeward_ekf_bearings(&ekf, (uint32_t)t, seen, (uint8_t)count);
      took = ticks() - took;
    }
    homeward_ekf_pose(&ekf, &pose);
    printf("%lu %d %lu", (unsigned long)INSTRUCTIONS(took), (int)status,
           (unsigned long)ekf.accepted);
    for (unsigned i = 0; i < HOMEWARD_STATES; i++) printf(" %.17g", (double)ekf.belief.state[i]);
    printf(" %.17g %.17g %.17g", (double)pose.x, (double)pose.y, (double)pose.heading);
    for (unsigned i = 0; i < 6; i++) printf(" %.17g", (double)pose.covariance[i]);
    printf("\n");
  }
  return 0;
}

/* Reads samples from standard input, one a line, and writes what the exported filter makes of each:
 * instructions and bytes of stack (on the emulated Cortex-M4F alone), status, accepted, state, pose,
 * covariance. */
#include "homeward_ekf.h"

#include <stdio.h>

#ifdef __arm__
/* SysTick counts down at 25 MHz; with -icount shift=5 an instruction takes 32 ns. */
#define SYSTICK ((volatile uint32_t *)0xE000E010)
#define PAINTED 4096U /* words below the stack of main */
static volatile uint32_t *below(void) {
  uint32_t sp;
  __asm__ volatile("mov %0, sp" : "=r"(sp));
  return (volatile uint32_t *)sp - PAINTED - 64; /* this function's own frame is above */
}
static uint32_t begin(void) {
  volatile uint32_t *const area = below();
  for (uint32_t k = 0; k < PAINTED; k++) area[k] = 0xA5A5A5A5U;
  SYSTICK[1] = 0xFFFFFFU;
  SYSTICK[2] = 0;
  SYSTICK[0] = 5;
  return SYSTICK[2];
}
static uint32_t instructions(uint32_t since) { return ((since - SYSTICK[2]) & 0xFFFFFFU) * 40U / 32U; }
static uint32_t stack(void) {
  volatile uint32_t *const area = below();
  uint32_t k = 0;
  while (k < PAINTED && area[k] == 0xA5A5A5A5U) k++;
  return 4U * (PAINTED + 64U - k);
}
#else
static uint32_t begin(void) { return 0; }
static uint32_t instructions(uint32_t since) { return since; }
static uint32_t stack(void) { return 0; }
#endif

static homeward_ekf ekf;
static homeward_resection resection;
static homeward_answer answer;

static homeward_real number(void) {
  double x = 0;
  if (scanf("%lf", &x) != 1) x = 0;
  return (homeward_real)x;
}

static void fill(homeward_real *to, unsigned count) {
  for (unsigned i = 0; i < count; i++) to[i] = number();
}

static void show(const homeward_pose *pose) {
  printf(" %.17g %.17g %.17g", (double)pose->x, (double)pose->y, (double)pose->heading);
  for (unsigned i = 0; i < 6; i++) printf(" %.17g", (double)pose->covariance[i]);
  printf("\n");
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
  settings.home_sigma = number();
  settings.speed_sigma = number();
  settings.turn_sigma = number();
  homeward_ekf_init(&ekf, &settings);
  homeward_resection_init(&resection, &settings);
  /* o: odometry; b: bearings; s: solve, and begin again from the answer if t is 1 */
  while (scanf(" %c %lu", &kind, &t) == 2) {
    homeward_sighting seen[64] = {{0, 0, 0}};
    homeward_status status = HOMEWARD_OK;
    homeward_pose pose;
    uint32_t took, deep;
    if (kind == 'o') {
      const homeward_real v = number(), omega = number();
      took = begin();
      status = homeward_ekf_odometry(&ekf, (uint32_t)t, v, omega);
      took = instructions(took);
      deep = stack();
      (void)homeward_resection_odometry(&resection, (uint32_t)t, v, omega);
    } else if (kind == 'b') {
      const unsigned count = (unsigned)number();
      for (unsigned i = 0; i < count; i++) {
        seen[i].landmark = (uint8_t)number();
        seen[i].bearing = number();
        seen[i].sigma = number();
      }
      took = begin();
      status = homeward_ekf_bearings(&ekf, (uint32_t)t, seen, (uint8_t)count);
      took = instructions(took);
      deep = stack();
      (void)homeward_resection_bearings(&resection, (uint32_t)t, seen, (uint8_t)count);
    } else {
      took = begin();
      homeward_resection_solve(&resection, &answer);
      took = instructions(took);
      deep = stack();
      if (t == 1) homeward_ekf_restart(&ekf, &answer);
      printf("s %lu %lu %d %lu %lu", (unsigned long)took, (unsigned long)deep, (int)answer.decided,
             (unsigned long)answer.located, (unsigned long)answer.consistent);
      show(&answer.pose);
      continue;
    }
    homeward_ekf_pose(&ekf, &pose);
    printf("%c %lu %lu %d %lu", kind, (unsigned long)took, (unsigned long)deep, (int)status,
           (unsigned long)ekf.accepted);
    for (unsigned i = 0; i < HOMEWARD_STATES; i++) printf(" %.17g", (double)ekf.belief.state[i]);
    show(&pose);
  }
  return 0;
}

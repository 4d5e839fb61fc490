/* An example: a simulated drive home past $landmarks landmarks. Replace its data by your odometry and
 * camera. Returns 0 if the pose at the end is that of homeward in Python. */
#include <stdio.h>

#include "homeward_ekf.h"

#define SAMPLES $samples

static const homeward_real polar[3] = {$polar}, sigma[3] = {$sigma};
static const homeward_real stored[HOMEWARD_LANDMARKS] = {$stored};
static const homeward_real twists[SAMPLES][2] = {
$twists
};
static const homeward_real bearings[SAMPLES][HOMEWARD_LANDMARKS] = {
$bearings
};
static const homeward_real expected[3] = {$expected};

int main(void) {
  static homeward_belief belief;
  static const homeward_real tolerance = (homeward_real)$tolerance;
  homeward_real seen[HOMEWARD_LANDMARKS], pose[3];
  homeward_start(&belief, polar, sigma);
  for (int k = 0; k < SAMPLES; k++) {
    for (int i = 0; i < HOMEWARD_LANDMARKS; i++) seen[i] = 1;
    if (homeward_predict(&belief, stored, twists[k][0], twists[k][1], (homeward_real)$dt)) return 2;
    if (homeward_update(&belief, bearings[k], seen)) return 2;
  }
  homeward_pose(&belief, pose);
  printf("x %.4f m, y %.4f m, heading %.4f rad\n", (double)pose[0], (double)pose[1], (double)pose[2]);
  for (int i = 0; i < 3; i++) {
    if (!(pose[i] - expected[i] < tolerance && expected[i] - pose[i] < tolerance)) return 1;
  }
  return 0;
}

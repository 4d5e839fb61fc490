/* The functions of homeward_ekf.h around the generated steps above. */
#include "homeward_ekf.h"

#include <string.h>

static homeward_belief next;
static homeward_real work[$work];
static int indices[$indices];

static int accept(homeward_belief *belief) {
  const homeward_real *values = next.state; /* the fields follow each other without gaps */
  for (unsigned i = 0; i < sizeof next / sizeof *values; i++) {
    if (!(values[i] < (homeward_real)$largest && values[i] > -(homeward_real)$largest)) return 1;
  }
  *belief = next;
  return 0;
}

void homeward_start(homeward_belief *belief, const homeward_real polar[3],
                    const homeward_real sigma[3]) {
  memset(belief, 0, sizeof *belief);
  for (int i = 0; i < HOMEWARD_STATES; i++) {
    belief->covariance[i * (HOMEWARD_STATES + 1)] = i < 3 ? sigma[i] * sigma[i] : 1;
  }
  memcpy(belief->state, polar, 3 * sizeof *polar);
}

int homeward_predict(homeward_belief *belief, const homeward_real stored[HOMEWARD_LANDMARKS],
                     homeward_real v, homeward_real omega, homeward_real dt) {
  const homeward_real control[2] = {v, omega};
  const homeward_real input_covariance[4] = {$speed_variance / dt, 0, 0, $turn_variance / dt};
  homeward_real state_variance[HOMEWARD_STATES] = {0};
  for (int i = 3; i < HOMEWARD_STATES; i++) state_variance[i] = $walk_variance * dt;
  const homeward_real *given[$predict_args] = {$predict_given};
  homeward_real *found[$predict_results] = {$predict_found};
  predict(given, found, indices, work, 0);
  return accept(belief);
}

int homeward_update(homeward_belief *belief, const homeward_real bearings[HOMEWARD_LANDMARKS],
                    const homeward_real seen[HOMEWARD_LANDMARKS]) {
  const homeward_real gate = $gate, minimum_visible = $minimum_visible;
  homeward_real variance[HOMEWARD_LANDMARKS];
  for (int i = 0; i < HOMEWARD_LANDMARKS; i++) variance[i] = $bearing_variance;
  const homeward_real *given[$update_args] = {$update_given};
  homeward_real *found[$update_results] = {$update_found};
  update(given, found, indices, work, 0);
  return accept(belief);
}

void homeward_pose(const homeward_belief *belief, homeward_real pose[3]) {
  const homeward_real R = belief->state[0], theta = belief->state[1];
  pose[0] = R * (homeward_real)cos((double)theta);
  pose[1] = R * (homeward_real)sin((double)theta);
  pose[2] = belief->state[2];
}

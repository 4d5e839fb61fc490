// Reads odometry and bearings as text from the serial port and writes the pose. Input lines:
//   o 0.125 0.02        v [m/s], omega [rad/s]
//   b 3 0.512           landmark 3 at 0.512 rad
//   e                   end of a stamp's bearings: update, and print x, y, heading
#include <homeward_ekf.h>

static homeward_ekf ekf;
static homeward_resection resection;
static homeward_sighting seen[HOMEWARD_LANDMARKS];
static uint8_t count = 0;
static uint32_t solved = 0;

void setup() {
  homeward_settings settings;
  Serial.begin(115200);
  homeward_defaults(&settings);
  settings.start[0] = 0.75;  // your start prior: R [m], theta, alpha [rad]
  settings.start_sigma[0] = 0.05;
  settings.start_sigma[1] = settings.start_sigma[2] = 0.1;
  for (uint8_t i = 0; i < HOMEWARD_LANDMARKS; i++) settings.stored[i] = 0;  // your home bearings
  homeward_ekf_init(&ekf, &settings);
  homeward_resection_init(&resection, &settings);
}

void loop() {
  if (!Serial.available()) return;
  const char kind = Serial.read();
  const uint32_t now = micros();
  if (kind == 'o') {
    const float v = Serial.parseFloat(), omega = Serial.parseFloat();
    homeward_ekf_odometry(&ekf, now, v, omega);
    homeward_resection_odometry(&resection, now, v, omega);
  } else if (kind == 'b' && count < HOMEWARD_LANDMARKS) {
    seen[count].landmark = Serial.parseInt();
    seen[count].bearing = Serial.parseFloat();
    seen[count++].sigma = 0;
  } else if (kind == 'e') {
    homeward_ekf_bearings(&ekf, now, seen, count);
    homeward_resection_bearings(&resection, now, seen, count);
    count = 0;
    if (now - solved > 1000000) {
      homeward_answer answer;
      solved = now;
      homeward_resection_solve(&resection, &answer);
      homeward_ekf_restart(&ekf, &answer);
    }
    homeward_pose pose;
    homeward_ekf_pose(&ekf, &pose);
    Serial.print(pose.x, 4);
    Serial.print(' ');
    Serial.print(pose.y, 4);
    Serial.print(' ');
    Serial.println(pose.heading, 4);
  }
}

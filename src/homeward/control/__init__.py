"""Control of a robot, real or simulated: homing laws, routes, limits and watchdogs."""

"""The EKF as C for microcontrollers."""

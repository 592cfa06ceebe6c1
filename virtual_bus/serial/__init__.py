"""The emulated detector IMU and the lines on which it can be reached: a pseudo terminal, a TCP port or a pipe in this process."""

"""The emulated detector IMU and the lines it can be reached on: a pseudo terminal or a pipe in this process."""

"""The detector's IMU on a serial line: Xbus framing, byte streams and the driver."""

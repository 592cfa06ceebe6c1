"""The bench, which runs a machine on a bus in closed loop at the sample rate."""

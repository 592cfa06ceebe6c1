"""The bench: who runs a machine on a bus, in closed loop at the sample rate."""

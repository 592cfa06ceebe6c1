"""What a fit may change of a machine: numbers of its file, of its controller's side and of its sensors, and parameters of effects."""

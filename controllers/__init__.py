"""Code that runs once per sample: excitation, jog, feedback, trajectories, shapers, observers, and the models they carry. No I/O."""

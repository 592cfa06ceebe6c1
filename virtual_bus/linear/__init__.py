"""The emulated machine as a linear system about rest at a pose: plant, effects, drives and sensors, and what is left out of it."""

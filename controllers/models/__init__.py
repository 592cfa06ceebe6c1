"""Models fitted to recordings, as controllers and observers run them. They know nothing of the emulated machine."""

"""Models fitted to recordings, as controllers and observers run them. They are independent of the emulated machine."""

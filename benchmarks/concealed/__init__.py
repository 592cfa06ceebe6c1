"""The concealed benchmark: recordings whose hidden physics is known to the scorer alone."""

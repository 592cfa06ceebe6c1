"""Free runs, and the machine file's own numbers re-tuned to recordings."""

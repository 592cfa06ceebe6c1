"""The table of faults: every fault of the emulated machine tried on one, and what became of it."""

"""Is an effect there at all: the gate, and by what the equations of those that were found may err."""

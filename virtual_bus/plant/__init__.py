"""The plant: a tree of rigid bodies, its equations generated and compiled, stepped with friction."""

"""The next experiment: what tells apart sets that these recordings do not."""

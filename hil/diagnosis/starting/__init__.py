"""The catalogue at every place of a machine, with values of parameters from which fits may start."""

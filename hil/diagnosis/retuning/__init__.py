"""Whether the numbers of the machine file are right, within their tolerances."""

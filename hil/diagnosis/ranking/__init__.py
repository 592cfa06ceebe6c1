"""Which set of effects is it, and how sure is its name: the evidence of every set against the others, nothing and the unknown."""

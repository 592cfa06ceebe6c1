"""Which effects act: sets of effects fitted together with the numbers, and weighed."""

"""Which sets of effects are fitted, judged and weighed: one effect more at a time, pairs, and others in their place."""

"""Which sets of effects are tried: one more at a time, pairs, others in their place; and what is begun anew beside them."""

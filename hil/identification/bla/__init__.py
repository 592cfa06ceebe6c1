"""Best linear approximation by averaging (thesis Sec. 3.4.1): periods, realisations, transients, detection lines."""

"""Judgement of the sensors, one sample at a time: what can be believed, and what follows where it cannot."""

"""How well a simulated machine predicts recordings, and the machine that predicts them best."""

"""Free runs beside one recording: driven by its efforts, in windows, or in closed loop from its reference."""

"""The closed loop simulated freely beside the mean of repeats: the judge of effects where the controller is known."""

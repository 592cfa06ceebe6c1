"""The truth: plants stepped by MuJoCo, effects in equations of their own. Imports none of hil, drivers, controllers, virtual_bus."""

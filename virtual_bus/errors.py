"""Errors of the emulated machine: an unusable plant, effect, fault or device description, or a lost bus."""


class EmulatorError(Exception):
    """Base of every error the emulated machine raises on purpose."""

    exit_status = 2


class PlantError(EmulatorError, ValueError):
    """A tree of bodies that is no plant: a loop, a moving joint without inertia, an inertia that is not positive definite."""


class EffectError(EmulatorError, ValueError):
    """An effect that does not exist, acts where it may not, or has a parameter out of bounds."""


class FaultError(EmulatorError, ValueError):
    """A fault that does not exist, acts where it may not, or has a parameter or condition that cannot be."""


class BusLostError(EmulatorError, ConnectionError):
    """The bus of an emulator is gone: its interface went down, its adapter was unplugged."""

    exit_status = 1

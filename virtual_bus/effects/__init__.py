"""Named physics that a machine may have besides its tree of bodies: one file per effect."""

from virtual_bus.effects.registry import catalogue

__all__ = ["catalogue"]

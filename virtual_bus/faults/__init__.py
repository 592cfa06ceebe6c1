"""Faults that a user can inject into the emulated machine: one file per kind of place, each fault declared once."""

from virtual_bus.faults.registry import catalogue, fault_kinds

__all__ = ["catalogue", "fault_kinds"]

"""A demonstration on the emulator: run, record, identify, simulate, compare, show."""

from hil.demo.story import run_demo

__all__ = ["run_demo"]

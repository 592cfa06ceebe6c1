"""A demonstration on the emulator: something is hidden, recorded, and named by the diagnosis."""

from hil.demo.story import run_demo

__all__ = ["run_demo"]

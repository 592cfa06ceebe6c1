"""Simulation of recordings on the plant of the machine file, and comparison of both."""

from hil.simulation.commands import in_effort
from hil.simulation.compare import ChannelComparison, Comparison, compare
from hil.simulation.inputs import Inputs
from hil.simulation.simulate import inputs_of, simulate
from hil.simulation.simulator import Outputs, Simulator

__all__ = ["ChannelComparison", "Comparison", "Inputs", "Outputs", "Simulator", "compare", "in_effort", "inputs_of", "simulate"]

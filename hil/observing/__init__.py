"""Design and use of the observer: its model from frequency responses, its noise, its tuning, its replay over recordings."""

from hil.observing.alarms import Alarm, alarms
from hil.observing.design_file import read_design, write_design
from hil.observing.estimate import Estimate, read_estimate, write_estimate
from hil.observing.observability import Observability, observability
from hil.observing.observer_design import ObserverDesign, design_observer, emulated_design
from hil.observing.replay import observe
from hil.observing.tuning import Tuning, tune

__all__ = [
    "Alarm",
    "Estimate",
    "Observability",
    "ObserverDesign",
    "Tuning",
    "alarms",
    "design_observer",
    "emulated_design",
    "observability",
    "observe",
    "read_design",
    "read_estimate",
    "tune",
    "write_design",
    "write_estimate",
]

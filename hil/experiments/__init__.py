"""Experiments of the bench, planned row by row and checked against limits before anything moves."""

from hil.experiments.file import experiment_from_text, read_experiment, write_experiment
from hil.experiments.jog import Jog, JogOnly
from hil.experiments.move import Move
from hil.experiments.multisine import Multisine
from hil.experiments.plan import Experiment, Plan
from hil.experiments.scan import Scan
from hil.experiments.static import Static
from hil.experiments.tour import Tour

__all__ = [
    "Experiment",
    "Jog",
    "JogOnly",
    "Move",
    "Multisine",
    "Plan",
    "Scan",
    "Static",
    "Tour",
    "experiment_from_text",
    "read_experiment",
    "write_experiment",
]

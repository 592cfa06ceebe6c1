"""Observers that several files here ask for: identifying or designing one takes a quarter of a minute or more."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import hil
from hil.experiments import Scan, Static
from hil.machine import Machine, load_machine
from hil.observing import ObserverDesign, design_observer, tune
from hil.observing.simulated_recordings import emulated_recording, emulated_responses
from hil.simulation import Simulator

HERE = Path(__file__).parent
POSES_rad = (-0.6, -0.3, 0.0, 0.3, 0.6)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Whatever asks for the observer is slow: the first of them waits for it."""
    for item in items:
        if isinstance(item, pytest.Function) and item.path.is_relative_to(HERE) and {"design", "hard_design"} & set(item.fixturenames):
            item.add_marker(pytest.mark.slow)


@pytest.fixture(scope="session")
def machine() -> Machine:
    return load_machine("carm")


@pytest.fixture(scope="session")
def design(machine: Machine) -> ObserverDesign:
    """Identified on the emulated C-arm around roll 0, tuned on an undisturbed scan."""
    poses = [{"roll": roll} for roll in POSES_rad]
    simulator = Simulator(machine)
    standing = [emulated_recording(machine, Static(4.0, pose).plans(machine)[0], 40 + i, simulator) for i, pose in enumerate(poses)]
    scan = emulated_recording(machine, Scan("roll", -0.5, 0.5, 0.5).plans(machine)[0], 60, simulator)
    sweep = emulated_recording(machine, Scan("roll", -0.6, 0.6, np.radians(45.0), sweeps=2).plans(machine)[0], 62, simulator)
    untuned = design_observer(machine, emulated_responses(machine, poses, seed=3), standing, modes=3, sweeps=[sweep])
    return dataclasses.replace(untuned, noise=tune(untuned.model, untuned.noise, [scan], evaluations=60).noise)


@pytest.fixture(scope="session")
def hard_design() -> ObserverDesign:
    """That of one command for the arm with friction, play and sensors' errors; making it takes half a minute."""
    return hil.design_observer("carm-real")

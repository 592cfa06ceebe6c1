"""The results of the demo, for its page."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hil.identification import FrequencyResponse
from hil.identification.modal.resonances import Resonances
from hil.machine import Machine
from hil.recording import Recording
from hil.simulation import Comparison
from virtual_bus.settings import EffectSetting


@dataclass(frozen=True)
class Story:
    """Everything the page shows."""

    machine: Machine
    paths: tuple[Path, ...]
    recording: Recording
    response: FrequencyResponse
    resonances: Resonances
    linearisation: np.ndarray
    nominal: Recording
    with_friction: Recording
    nominal_comparison: Comparison
    friction_comparison: Comparison
    effect: EffectSetting
    recorded_s: float
    lockstep_factor: float

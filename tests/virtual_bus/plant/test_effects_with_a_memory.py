"""An effect with a memory is solved implicitly: what its law asks for of a step's two speeds is what acted in that step."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from small_plants import BLOCK_MASS_kg, block, run

from virtual_bus.effects import bouc_wen_hysteresis, presliding_hysteresis
from virtual_bus.effects.motion import ReactionState
from virtual_bus.plant.drives import DRIVE_STATES
from virtual_bus.settings import EffectSetting

STEP_s = 1.0 / 256.0
TIME_s = np.arange(512) * STEP_s
FORCES = 9.0 * np.sin(2.0 * np.pi * 1.3 * TIME_s) + 2.0 * np.sin(2.0 * np.pi * 7.0 * TIME_s) + 1.0
POSITION, SPEED, MEMORY, REACTION_EFFORT = 0, 1, 4 + 6 + 1 + DRIVE_STATES, 4 + 6 + 1 + DRIVE_STATES + 2  # of a block's state

STIFF = {
    "presliding_hysteresis": [
        {"Fc": 3.0, "Fs_minus_Fc": 0.0, "vs": 0.05, "sigma0": sigma0, "sigma1": sigma1}
        for sigma0 in (1e5, 1e7, 1e9)
        for sigma1 in (0.0, 20.0)
    ],
    "bouc_wen_hysteresis": [
        {"k": 3.0 / z_max, "A": 1.0, "z_max": z_max, "beta_share": share, "n": n}
        for z_max in (1e-2, 1e-5, 1e-9)
        for share, n in ((0.5, 1.0), (0.9, 2.5))
    ],
}
LAWS = {"presliding_hysteresis": presliding_hysteresis.react, "bouc_wen_hysteresis": bouc_wen_hysteresis.react}


@pytest.mark.parametrize(("mass_kg", "rounding_m_s"), [(BLOCK_MASS_kg, 1e-9), (0.02, 1e-7)])
@pytest.mark.parametrize(("name", "number"), [(name, number) for name, sets in STIFF.items() for number in range(len(sets))])
def test_what_acted_in_a_step_is_what_the_law_asks_for_however_stiff_it_is(
    name: str, number: int, mass_kg: float, rounding_m_s: float
) -> None:
    """A light block's bristles stop it within a step from two orders further off."""
    parameters = STIFF[name][number]
    states = run(
        block(mass_kg=mass_kg, stiffness=150.0, damping=2.0, effects=(EffectSetting(name, "rail", parameters),), substeps=1),
        FORCES[:, None],
    )
    asked = []
    for before, after in itertools.pairwise(states):
        state = ReactionState(before[MEMORY], 0.0, before[POSITION], before[SPEED], after[SPEED], STEP_s)
        asked.append(LAWS[name](state, **parameters)[0])
    missing = np.abs(np.array(asked) - states[1:, REACTION_EFFORT]) * STEP_s / mass_kg
    assert np.ptp(states[:, POSITION]) > 1e-3
    assert missing.max() < rounding_m_s, f"m/s in step {missing.argmax()}"


def test_parts_of_a_step_are_as_many_as_its_path_asks_for() -> None:
    law = {"k": 200.0, "A": 1.0, "z_max": 0.02, "beta_share": 0.7, "n": 1.5}
    for speed in (0.01, 0.3, 2.0, -2.0):
        parts = 4096
        first, total = 0.005, 0.0
        for _ in range(parts):
            effort, first, _ = bouc_wen_hysteresis.react(ReactionState(first, 0.0, 0.0, speed, speed, STEP_s / parts), **law)
            total += effort / parts
        effort, end, _ = bouc_wen_hysteresis.react(ReactionState(0.005, 0.0, 0.0, speed, speed, STEP_s), **law)
        assert abs(end - first) < 2e-4 * law["z_max"]
        assert abs(effort - total) < 3e-4 * law["k"] * law["z_max"]

"""Linear answers about a machine whose file has effects: right to a degree, and with what they leave out beside them."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import scipy.linalg

from controllers.feedback import Feedback
from hil.machine import Machine, check_machine, load_machine
from hil.machine.finding import Finding
from hil.shaping.choice import choose_shaper
from virtual_bus.physics import Physics
from virtual_bus.settings import EffectSetting

ROWS = 1400
PUSH = 0.02
"""A: so little that no limit is met while the motion grows."""


@pytest.fixture(scope="module")
def turntable() -> Machine:
    return load_machine("turntable")


def having(machine: Machine, *effects: EffectSetting) -> Machine:
    """With these effects, and encoders and drives without steps, below which a small motion would be lost."""
    encoders = tuple(replace(each, resolution=0.0) for each in machine.plant.encoders)
    return replace(machine, plant=replace(machine.plant, encoders=encoders, effects=effects))


def late(machine: Machine, delay_s: float) -> Machine:
    return having(machine, EffectSetting("delay", "turn", {"Td": delay_s}))


def pushed(machine: Machine) -> tuple[float, float]:
    """Return how fast the emulated loop's oscillation grows [1/s] and its frequency [Hz] after a push of a row, as it swings."""
    physics, feedback = Physics(machine.plant, noise=False), Feedback(machine.controllers)
    nothing = np.zeros(1)
    physics.place(nothing)
    physics.hold(nothing)
    feedback.preload(nothing, nothing, nothing)
    command, positions = nothing.copy(), np.zeros(ROWS)
    for k in range(ROWS):
        physics.apply(command)
        positions[k] = physics.latch().position[0]
        feedback.step(nothing, positions[k : k + 1], np.array([PUSH if k == 0 else 0.0]), nothing, command)
        physics.advance()
    swing = np.diff(positions)  # the integrator's slow return is not in it
    ups = np.flatnonzero((swing[:-1] < 0.0) & (swing[1:] >= 0.0))
    at = ups + swing[ups] / (swing[ups] - swing[ups + 1])
    heights = np.array([np.ptp(swing[a:b]) for a, b in pairwise(ups[2:])])
    growth = np.polyfit(ups[2:-1] / machine.sample_rate_Hz, np.log(heights), 1)[0]
    return float(growth), float((len(at) - 3) / (at[-1] - at[2]) * machine.sample_rate_Hz)


def margin(findings: list[Finding]) -> Finding:
    return next(finding for finding in findings if finding.name == "phase_margin")


def test_the_phase_margin_of_a_late_drive_is_what_is_left_until_the_emulated_loop_oscillates(turntable: Machine) -> None:
    """A further delay turns the loop's phase at its crossover and leaves its gain: where motion neither grows nor fades, none is left."""
    delays = (0.0470, 0.0500)
    (slower, _), (faster, frequency_Hz) = (pushed(late(turntable, delay_s)) for delay_s in delays)
    assert slower < 0.0 < faster
    last_s = delays[0] + (delays[1] - delays[0]) * slower / (slower - faster)
    for delay_s in (0.0, 0.011, 0.03, 0.05):
        found = margin(check_machine(late(turntable, delay_s), poses=3))
        assert found.values["phase_deg"] == pytest.approx(360.0 * frequency_Hz * (last_s - delay_s), abs=1.0)
        assert found.ok is (delay_s < 0.012)


def test_a_loop_that_its_delay_makes_unstable_is_found_and_by_how_much(turntable: Machine) -> None:
    findings = {finding.name: finding for finding in check_machine(late(turntable, 0.05), poses=3)}
    assert not findings["stability"].ok
    assert -3.0 < findings["phase_margin"].values["phase_deg"] < 0.0
    assert not findings["gain_margin"].ok


def test_old_readings_take_as_much_of_the_margin_as_a_late_drive(turntable: Machine) -> None:
    old = having(turntable, EffectSetting("clock_offset", "turn", {"t0": 0.03, "delta": 0.0}))
    found = [margin(check_machine(machine, poses=3)).values["phase_deg"] for machine in (late(turntable, 0.03), old)]
    assert found[1] == pytest.approx(found[0], abs=0.3)


def test_a_margin_that_is_without_an_effect_says_so_and_is_no_ok(turntable: Machine) -> None:
    rubbing = having(turntable, EffectSetting("coulomb_friction", "turn", {"Fc": 8.0}), EffectSetting("delay", "turn", {"Td": 0.001}))
    findings = check_machine(rubbing, poses=3)
    linear = [finding for finding in findings if finding.name in ("mode", "stability", "phase_margin", "gain_margin", "crossover")]
    assert all(finding.mark == "note" and "without coulomb_friction" in finding.text for finding in linear)
    (named,) = [each for finding in findings for each in finding.values.get("left_out", ())]
    assert (named["name"], named["at"]) == ("coulomb_friction", "turn")
    assert all(finding.mark == "ok" for finding in check_machine(late(turntable, 0.001), poses=3) if finding.name == "phase_margin")


def test_a_shaper_is_designed_for_the_modes_that_the_file_has_as_effects(turntable: Machine) -> None:
    modes = (
        EffectSetting("structural_mode", "turn", {"J": 1.0, "f": 7.0, "zeta": 0.01}),
        EffectSetting("structural_mode", "table", {"J": 0.6, "f": 13.0, "zeta": 0.01}),
    )
    choice = choose_shaper(having(turntable, *modes, EffectSetting("coulomb_friction", "turn", {"Fc": 8.0})), "turn")
    ringing_Hz = sorted(abs(pole) / (2.0 * np.pi) for pole in choice.chosen.cancelled[0])
    # table and rotor of 7.0 + 0.6 kg m^2 with both parts on their springs, none of it held
    stiffness = [1.0 * (2.0 * np.pi * 7.0) ** 2, 0.6 * (2.0 * np.pi * 13.0) ** 2]
    springs = np.array([[sum(stiffness), *(-k for k in stiffness)], [-stiffness[0], stiffness[0], 0.0], [-stiffness[1], 0.0, stiffness[1]]])
    free_Hz = np.sqrt(scipy.linalg.eigh(springs, np.diag([7.6, 1.0, 0.6]), eigvals_only=True)[1:]) / (2.0 * np.pi)
    np.testing.assert_allclose(ringing_Hz, free_Hz, rtol=0.03)
    assert [(each.name, each.at) for each in choice.outside] == [("coulomb_friction", "turn")]

"""What a design states of the vibration that it leaves holds on the machine: with feedback, friction and frequencies that are off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from controllers.feedback import Feedback
from controllers.shapers.filter import ReferenceShaper
from hil.machine import Machine, load_machine
from hil.shaping.choice import ShaperChoice, choose_shaper
from hil.shaping.plans import shaped
from hil.shaping.predicted import DrawnMove, drawn_moves
from virtual_bus.physics import Physics
from virtual_bus.settings import EffectSetting

MODE_Hz = 6.0
LOOKED_AT = 200
FRICTION_Nm = 2.0


def rubbing(friction: float, mode_Hz: float = MODE_Hz) -> Machine:
    """The turntable with a part that swings on it, and dry friction."""
    machine = load_machine("turntable")
    effects = (
        EffectSetting("structural_mode", "table", {"J": 1.0, "f": mode_Hz, "zeta": 0.01}),
        EffectSetting("coulomb_friction", "turn", {"Fc": friction}),
    )
    links = tuple(replace(each, resolution=0.0) if each.channel.startswith("link_") else each for each in machine.plant.encoders)
    return replace(machine, plant=replace(machine.plant, encoders=links, effects=effects))


def measured(machine: Machine, drawn: DrawnMove, choice: ShaperChoice) -> list[float]:
    """Return how much the emulated machine swings after a move without and with the shaper, sample by sample over its own loop."""
    running = ReferenceShaper(machine.axes, [choice.shaper], machine.limits, machine.sample_rate_Hz)
    after = []
    for reference, begin in (
        (drawn.reference, drawn.arrived),
        (shaped(running, drawn.reference, drawn.reference[0])[0], drawn.arrived + choice.shaper.transient_samples),
    ):
        physics, feedback = Physics(machine.plant, noise=False), Feedback(machine.controllers)
        nothing, command = np.zeros(1), np.zeros(1)
        physics.place(reference[0])
        physics.hold(nothing)
        feedback.preload(nothing, reference[0], nothing)
        positions = np.zeros(len(reference))
        resolution = machine.plant.drives[0].resolution
        for k in range(len(reference)):
            physics.apply(resolution * np.floor(command / resolution + 0.5))
            latched = physics.latch()
            positions[k] = latched.link_position[0]
            feedback.step(reference[k], latched.position, nothing, nothing, command)
            physics.advance()
        swing = np.diff(positions, 2)[begin - 1 : begin - 1 + LOOKED_AT]
        time = np.arange(len(swing))
        after.append(float(np.std(swing - np.polyval(np.polyfit(time, swing, 2), time))))
    return after


@pytest.fixture(scope="module")
def choice() -> ShaperChoice:
    return choose_shaper(rubbing(FRICTION_Nm), "turn")


def test_the_stated_interval_holds_what_moves_leave_on_the_emulated_machine(choice: ShaperChoice) -> None:
    stated = choice.chosen.verdict.residual
    assert stated is not None
    moves = drawn_moves(choice.machine, "turn", np.zeros(1), choice.shaper.transient_samples + LOOKED_AT + 1, seed=7, count=6)
    swings = np.array([measured(rubbing(FRICTION_Nm, MODE_Hz * (1.0 + drawn.detuned)), drawn, choice) for drawn in moves])
    left = swings[:, 1] / np.sqrt(np.mean(swings[:, 0] ** 2))
    assert np.count_nonzero((left > 0.9 * stated.low) & (left < 1.1 * stated.high)) >= 5
    assert left.max() > 10.0 * choice.chosen.verdict.vibration_at_10  # which the linear loop states


def test_friction_leaves_more_than_the_linear_loop_says_and_the_recommendation_counts_it(choice: ShaperChoice) -> None:
    fit = [design for design in choice.designs if not design.verdict.against]
    assert all(design.verdict.residual is not None for design in fit)
    assert [design.name for design in fit] == [design.name for design in sorted(fit, key=lambda design: design.verdict.cost)]
    best = choice.chosen.verdict
    assert best.residual is not None
    assert best.residual.low <= best.residual.likely <= best.residual.high
    assert best.cost == pytest.approx(best.residual.high + best.tracking)
    assert best.residual.likely > 3.0 * best.vibration

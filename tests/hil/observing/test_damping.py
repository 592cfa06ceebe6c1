"""Claims about damping feedback: the mode gets the ratio that was asked for, in and out without a step, where margins are kept."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from observed_models import DenseModel, small_model, small_noise
from ring_down import ratio_of, rung, rung_ratio

from controllers.damping import DampingSettings, ModalDamping
from controllers.errors import DesignError
from controllers.observers.modal_observer import ModalObserver
from hil.errors import UnusableInputError
from hil.machine import Machine
from hil.machine.closed_loop import position_loop
from hil.observing import ObserverDesign, observe
from hil.observing.damping import DampedLoop, DampedPose, accept_damping
from hil.observing.live import LiveObserver
from virtual_bus.physics import Physics

REST = np.zeros(2)
STATES = 24


def damped_live(design: ObserverDesign, ratio: float) -> LiveObserver:
    observer = design.observer()
    return LiveObserver(observer, "", ModalDamping(observer, DampingSettings(ratio)), ("A", "A"))


def small_law(ratio: float = 0.1, modes: int = 4, mode: int = 0) -> ModalDamping:
    """On the small model at pose zero."""
    observer = ModalObserver(small_model(modes=modes), small_noise(modes=modes))
    observer.linearised(REST)
    return ModalDamping(observer, DampingSettings(ratio, mode))


@pytest.mark.slow
@pytest.mark.parametrize("wanted", [0.05, 0.15])
def test_with_the_true_state_the_law_gives_the_ratio_that_is_asked_for(wanted: float) -> None:
    """Against matrices of an independent derivation; the mode alone, since the law answers for no other."""
    dense, law = DenseModel(small_model(modes=1), small_noise(modes=1)), small_law(wanted, modes=1)
    states = dense.states
    nothing = np.zeros(states)
    F = np.column_stack([dense.transition(unit, REST) - dense.transition(nothing, REST) for unit in np.eye(states)])
    G = np.column_stack([dense.transition(nothing, unit) - dense.transition(nothing, REST) for unit in np.eye(2)])

    def command(x: np.ndarray, acting: np.ndarray) -> np.ndarray:
        out = np.zeros(2)
        law.law(x, acting, out)
        return out

    base = command(nothing, REST)
    L = np.column_stack([command(unit, REST) - base for unit in np.eye(states)])
    M = np.column_stack([command(nothing, unit) - base for unit in np.eye(2)])
    # [mode's deflection and speed; command on the wire], the command of row k acting from k+1
    mode = np.ix_([4, 5], [4, 5])
    loop = np.block([[F[mode], G[[4, 5]]], [L[:, [4, 5]], M]])
    assert ratio_of(np.linalg.eigvals(loop), 8.0) == pytest.approx(wanted, rel=0.1)


def test_at_rest_under_gravity_it_asks_for_nothing() -> None:
    law, out, x = small_law(), np.zeros(2), np.zeros(STATES)
    values = small_model().coefficients[:, 0]
    holding = -np.linalg.solve(values[4 * 14 : 4 * 14 + 4].reshape(2, 2), values[4 * 14 + 6 : 4 * 14 + 8])
    for i in range(4):  # where the springs bear the push and what the drives hold
        x[4 + i] = values[4 * 14 + 8 + i] + values[14 * i + 12 : 14 * i + 14] @ holding
    law.law(x, holding, out)
    assert np.abs(out).max() < 1e-12


def test_it_predicts_with_the_command_as_the_drives_round_it() -> None:
    observer = ModalObserver(dataclasses.replace(small_model(), effort_step=np.array([0.1, 0.0])), small_noise())
    observer.linearised(REST)
    efforts = []
    for acting in (np.array([0.46, 0.02]), np.array([0.5, 0.02])):
        law = ModalDamping(observer, DampingSettings(0.1))
        law.restart(10_000)
        for k in range(300):
            law.step(np.zeros(STATES), acting, True, k)
        efforts.append(law.effort.copy())
    assert np.abs(efforts[0]).max() > 0.0
    assert np.array_equal(*efforts)


def test_without_damping_the_whole_loop_is_the_position_loop(machine: Machine, design: ObserverDesign) -> None:
    pose = np.array([0.0, 0.3])
    physics = Physics(machine.plant, noise=False)
    whole = DampedLoop(machine, physics, design.observer(), None, pose)
    alone = position_loop(machine, physics.linear(pose))
    for ours, theirs in zip(whole.margins(), alone.margins(), strict=True):
        assert dataclasses.astuple(ours) == pytest.approx(dataclasses.astuple(theirs), rel=1e-3)
    assert whole.damping_ratio(8.3) > 0.03


@pytest.mark.nightly
def test_the_ring_down_on_the_bus_is_that_of_the_linear_loop(machine: Machine, design: ObserverDesign, tmp_path: Path) -> None:
    physics = Physics(machine.plant, noise=False)
    found = {}
    for wanted in (0.0, 0.1):
        live = damped_live(design, wanted) if wanted else LiveObserver(design.observer())
        found[wanted] = rung_ratio(machine, live, tmp_path)
        expected = DampedLoop(machine, physics, live.observer, live.damping, REST).damping_ratio(8.3)
        assert found[wanted] == pytest.approx(expected, abs=0.02)
    assert found[0.1] > 2.0 * found[0.0]


def test_it_comes_and_goes_without_a_step_and_a_replay_is_the_same(machine: Machine, design: ObserverDesign, tmp_path: Path) -> None:
    recording = rung(machine, damped_live(design, 0.1), tmp_path / "damped.mf4")
    share = recording["damping_share"]
    assert share[0] == share[-1] == 0.0
    assert share.max() == 1.0
    assert np.abs(np.diff(share)).max() <= 1.0 / 128 + 1e-12
    assert np.flatnonzero(share)[0] == pytest.approx(256, abs=2)  # after a second that proves the estimate
    assert 0.05 < np.abs(recording["damping_propeller"]).max() <= 2.0
    added = recording.matrix(["damping_propeller", "damping_roll"])
    assert np.abs(np.diff(added, axis=0)).max() < 0.65  # a swing of the whole limit at 1.5 times 8 Hz
    replayed = observe(recording, design.observer())
    assert np.array_equal(recording.matrix(replayed.names), replayed.values, equal_nan=True)


def _settled(law: ModalDamping) -> np.ndarray:
    """Rows of an 8 Hz swing until all of the damping is in force; the state of the last."""
    x = np.zeros(STATES)
    law.restart(10_000)
    for k in range(600):
        x[4], x[8] = 1e-3 * np.sin(0.196 * k), 1e-3 * 50.0 * np.cos(0.196 * k)
        law.step(x, REST, True, k)
    assert law.share == 1.0
    assert np.abs(law.effort).max() > 1e-3
    return x


@pytest.mark.parametrize("broken", ["doubted", "not a number"])
def test_an_estimate_that_cannot_be_trusted_ramps_it_out_and_a_second_of_a_good_one_brings_it_back(broken: str) -> None:
    law = small_law()
    x = _settled(law)
    bad = np.full(STATES, np.nan) if broken == "not a number" else x
    efforts = [law.effort.copy()]
    for k in range(128):
        law.step(bad, REST, False, 600 + k)
        efforts.append(law.effort.copy())
    assert np.isfinite(efforts).all()
    assert law.share == 0.0
    assert not law.effort.any()
    assert np.abs(np.diff(efforts, axis=0)).max() <= np.abs(efforts[0]).max() / 127
    shares = []
    for k in range(256 + 128 + 1):
        law.step(x, REST, True, 728 + k)
        shares.append(law.share)
    assert shares[255] == 0.0
    assert shares[-1] == 1.0


def test_lost_ticks_bring_the_end_of_the_plan_nearer_and_it_is_off_there_without_a_jump() -> None:
    law = small_law()
    x = _settled(law)
    end, shares, tick = 10_000 - 1, [], 10_000 - 400
    while tick <= end:
        law.step(x, REST, True, tick)
        shares.append(law.share)
        tick += 9 if tick % 3 == 0 and tick < end - 9 else 1  # eight lost now and then
    assert shares[0] == 1.0
    assert shares[-1] == 0.0
    assert np.diff(shares).min() >= -9.0 / 128 - 1e-12
    assert shares[-2] <= 1.0 / 128 + 1e-12


def test_a_jump_of_the_estimate_is_no_jump_of_the_command() -> None:
    law = small_law()
    x = _settled(law)
    before = law.effort.copy()
    law.step(x + 1.0, REST, True, 600)
    assert np.abs(law.effort - before).max() < 0.65
    for k in range(50):
        law.step(x + 1.0, REST, True, 601 + k)
    assert np.abs(law.effort).max() <= 0.25 * 8.0 + 1e-12


def test_more_than_the_margins_allow_is_refused_in_one_line(machine: Machine, design: ObserverDesign) -> None:
    physics, pose, observer = Physics(machine.plant, noise=False), (0.0, 0.3), design.observer()
    results = {}
    for wanted in (0.05, 0.5, 3.0):
        law = ModalDamping(observer, DampingSettings(min(wanted, 1.0)))
        loop = DampedLoop(machine, physics, observer, law, np.array(pose))
        radius = float(np.abs(loop.poles()).max()) if wanted <= 1.0 else 1.01
        results[wanted] = [DampedPose(pose, radius, loop.margins(), loop.damping_ratio(8.3), 0.05)]
    assert "margins at least" in accept_damping(machine, results[0.05])
    for wanted, word in ((0.5, "of phase margin"), (3.0, "unstable in 1 of 1 poses")):
        with pytest.raises(UnusableInputError, match=word) as caught:
            accept_damping(machine, results[wanted])
        assert "\n" not in str(caught.value)
        assert "roll 17.19 deg" in str(caught.value)


@pytest.mark.parametrize(("imu", "has"), [("", "the bench has none"), ("imu_source", "the bench has imu_source")])
def test_damping_without_an_imu_that_the_model_knows_is_refused_since_it_would_never_come_in(imu: str, has: str) -> None:
    observer = ModalObserver(small_model(), small_noise())
    with pytest.raises(UnusableInputError, match=f"{has}, the observer's model looks at imu_x") as caught:
        LiveObserver(observer, "", ModalDamping(observer, DampingSettings(0.1)), ("A", "A"), imu=imu)
    assert "\n" not in str(caught.value)
    LiveObserver(observer, imu=imu)  # watching goes without


@pytest.mark.parametrize(
    ("settings", "word"), [(DampingSettings(0.1, 7), "modes 1 to 4"), (DampingSettings(1.5), "above 0, and 1 at most")]
)
def test_what_is_no_damping_is_refused(settings: DampingSettings, word: str) -> None:
    with pytest.raises(DesignError, match=word):
        small_law(settings.ratio, mode=settings.mode)


def test_a_mode_that_no_drive_moves_cannot_be_damped() -> None:
    model = small_model()
    model.coefficients[1 * 14 + 12 : 2 * 14] = 0.0
    with pytest.raises(DesignError, match="mode 2: no drive moves it"):
        ModalDamping(ModalObserver(model, small_noise()), DampingSettings(0.1, mode=1))

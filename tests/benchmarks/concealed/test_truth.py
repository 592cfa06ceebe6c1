"""The truth stands apart from the tool, and without hidden physics both see the same machine."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from places import BENCHMARKS
from scipy.interpolate import CubicSpline

pytestmark = pytest.mark.nightly

if TYPE_CHECKING:
    from concealed.truth.kinds import Kind
    from concealed.truth.plant import Machine

TRUTH = BENCHMARKS / "concealed" / "truth"


def test_the_truth_imports_none_of_the_four_packages() -> None:
    imported = set()
    for path in TRUTH.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                imported |= {name.name.split(".")[0] for name in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                imported |= {".".join(node.module.split(".")[:2]) if node.module.startswith("concealed") else node.module.split(".")[0]}
    assert not imported & {"hil", "drivers", "controllers", "virtual_bus"}
    assert {name for name in imported if name.startswith("concealed")} == {"concealed.truth"}


# Both loops round positions and targets to lattices, so efforts differ by a few of their steps; the IMU's high frequencies carry that on.
LARGEST_NRMSE = {"current": 0.01, "effort": 0.002, "position": 2e-4, "link": 2e-4, "imu": 0.015, "gyro": 2e-3}


@pytest.mark.parametrize("name", ["tilted_arm", "slider", "pan_tilt", "spring_mass", "carm"])
def test_without_hidden_physics_the_simulation_gives_the_same_recording(machines: dict[str, Machine], tmp_path: Path, name: str) -> None:
    from concealed.truth.experiments import Experiment, plan
    from concealed.truth.plant import Plant, Setup
    from concealed.truth.writing import write_recording

    from hil.machine import load_machine
    from hil.recording import read_recording
    from hil.simulation import simulate

    machine = machines[name]
    drive = plan(machine, Experiment("mixed", 3, duration_s=6.0))
    answer = Plant(machine, Setup()).run(drive)
    columns = {"time": np.arange(len(drive.reference)) / machine.rate_Hz}
    for i, axis in enumerate(machine.axes):
        if machine.closed:
            columns |= {f"reference_{axis}": drive.reference[:, i], f"excitation_{axis}": drive.excitation[:, i]}
        columns[f"command_{axis}"] = answer.command[:, i]
    write_recording(
        tmp_path / "run.csv", machine, columns | answer.channels, {"start_pose": drive.start.tolist()}, answer.controller_states
    )
    recorded = read_recording(tmp_path / "run.csv")
    simulated = simulate(load_machine(str(machine.path)), recorded)
    compared = 0
    for channel in machine.channels():
        spread = float(np.std(recorded[channel]))
        if spread > 1e-9:
            error = float(np.std(recorded[channel] - simulated[channel])) / spread
            assert error < LARGEST_NRMSE[channel.split("_")[0]], (channel, error)
            compared += 1
    assert compared >= 2


@pytest.mark.nightly
def test_every_kind_of_physics_changes_some_channel_and_goes_to_none_with_its_strength(machines: dict[str, Machine]) -> None:
    from concealed.truth.catalogue import KINDS
    from concealed.truth.experiments import Experiment, plan
    from concealed.truth.plant import Plant, Setup
    from concealed.truth.sensor_kinds import read, with_losses

    drives = {name: plan(machine, Experiment("mixed", 5)) for name, machine in machines.items()}

    def seen(machine: Machine, kind: Kind, place: str, shape: dict[str, float], strength: float) -> dict[str, np.ndarray]:
        setup = Setup()
        kind.add(setup, machine, place, shape, strength)
        answer = Plant(machine, setup).run(drives[machine.name], lattices=False)
        assert not answer.failed
        return with_losses(setup, read(setup, answer.channels, machine.rate_Hz), np.random.default_rng(1))

    silent, loud, abrupt = [], [], []
    bases = {}
    for kind in KINDS.values():
        name, machine = next((name, machine) for name, machine in machines.items() if kind.places(machine))
        place = kind.places(machine)[0]
        shape = kind.draw(np.random.default_rng(2), machine, place)
        if name not in bases:
            bases[name] = Plant(machine, Setup()).run(drives[name], lattices=False).channels
        changed = seen(machine, kind, place, shape, 0.5 * kind.largest(machine, place))
        if not any(np.abs(changed[channel] - bases[name][channel]).max() > 1e-7 for channel in machine.channels()):
            silent.append(kind.name)
        nothing = seen(machine, kind, place, shape, 0.0)
        if any(not np.array_equal(nothing[channel], bases[name][channel]) for channel in machine.channels()):
            loud.append(kind.name)
        faint = seen(machine, kind, place, shape, 1e-7 * kind.largest(machine, place))
        worst = max(
            np.linalg.norm(faint[channel] - bases[name][channel]) / (np.linalg.norm(changed[channel] - bases[name][channel]) + 1e-6)
            for channel in machine.channels()
        )
        if worst > 0.05 and kind.name not in ("drive_bandwidth", "delay"):  # late at all, a drive shows the current before its new command
            abrupt.append((kind.name, round(float(worst), 3)))
    assert silent == []
    assert loud == []
    assert abrupt == []


@pytest.mark.parametrize(
    ("begin", "end", "mean"), [(0.0, 0.0, 3.0), (0.0, 0.25, 3.0), (0.25, 0.5, 2.2), (0.5, 0.75, 1.0), (0.75, 1.0, 1.0)]
)
def test_a_late_target_acts_until_the_new_one_takes_over(begin: float, end: float, mean: float) -> None:
    """At two fifths of a row, from 3 to 1."""
    from concealed.truth.loop import held

    assert held.py_func(1.0, 3.0, 0.4, begin, end) == pytest.approx(mean)
    assert held.py_func(1.0, 3.0, 0.0, begin, end) == 1.0


def test_coulomb_friction_costs_its_level_in_each_direction(machines: dict[str, Machine]) -> None:
    from concealed.truth.catalogue import KINDS
    from concealed.truth.plant import Drive, Plant, Setup

    machine = machines["slider"]
    t = np.arange(1600) / machine.rate_Hz
    reference = (0.2 * np.abs((t / 4.0 + 0.5) % 2.0 - 1.0) - 0.1)[:, None]  # 0.05 m/s down and up
    efforts = []
    for strength in (0.0, 6.0):
        setup = Setup()
        KINDS["coulomb_friction"].add(setup, machine, "carriage", {}, strength)
        answer = Plant(machine, setup).run(Drive(reference, np.zeros_like(reference), reference[0]), lattices=False)
        efforts.append(answer.channels["effort_carriage"])
    added = (efforts[1] - efforts[0]) * machine.gear[0]
    speed = np.gradient(reference[:, 0], t)
    steady = {sign: (np.sign(speed) == sign) & (np.abs((t + 2.0) % 4.0 - 3.5) < 0.3) for sign in (-1.0, 1.0)}
    for sign, rows in steady.items():
        assert rows.sum() > 50
        assert np.mean(added[rows]) == pytest.approx(6.0 * sign, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tilted_arm", "carm"])
def test_the_truths_own_step_is_below_what_its_noise_could_show(
    machines: dict[str, Machine], monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    from concealed.truth import plant
    from concealed.truth.draw import draw
    from concealed.truth.oracle import NoiseUnits
    from concealed.truth.workshop import Workshop

    case = next(case for number in range(100) if (case := draw(number, 4, machines)).machine == name and case.training.kind == "mixed")
    shop = Workshop(case, machines[name])
    setup = shop.setup(())
    usual = shop.matrix(setup, shop.training)
    repeats = [shop.recorded(setup, shop.training, repeat) for repeat in range(case.repeats)]
    units = NoiseUnits(shop.noise(repeats, usual))
    monkeypatch.setattr(plant, "STEP_S", plant.STEP_S / 3.0)
    assert np.linalg.norm(units(shop.matrix(setup, shop.training) - usual)) < 1.5


def test_the_oracle_sees_the_samples_that_the_recordings_lose(machines: dict[str, Machine]) -> None:
    """A lost reading repeats the last one, noise and all; the oracle's difference is where one of the case's recordings has such rows."""
    from concealed.truth.catalogue import KINDS
    from concealed.truth.draw import Hidden, draw
    from concealed.truth.workshop import Chosen, Workshop

    case = next(case for number in range(200) if (case := draw(number, 4, machines)).machine == "tilted_arm" and not case.hidden)
    shop = Workshop(case, machines["tilted_arm"])
    kind = KINDS["sample_dropout"]
    place = "gyro_y"
    channel = case.channels.index(place)
    setup = shop.setup((Chosen(Hidden(kind, place, {}, 1.0), 0.02),))
    for drive, repeats in ((shop.training, range(case.repeats)), (shop.held_out, [case.repeats])):
        difference = np.abs(shop.matrix(setup, drive) - shop.matrix(shop.setup(()), drive))
        changed = difference[:, channel] > 1e-12
        repeated = np.array([np.diff(shop.recorded(setup, drive, repeat).channels[place], prepend=np.nan) == 0.0 for repeat in repeats])
        assert not np.any(changed & ~np.any(repeated, axis=0))
        assert len(changed) / 100 < changed.sum() < len(changed) / 5
        assert np.delete(difference, channel, axis=1).max() < 1e-12


def test_an_imus_second_pole_lags_by_its_time_constant(machines: dict[str, Machine]) -> None:
    from concealed.truth.experiments import Experiment, plan
    from concealed.truth.plant import Plant, Setup

    machine, lag_s = machines["tilted_arm"], 1e-3
    drive = plan(machine, Experiment("steps", 3, duration_s=4.0))
    before, after = (
        Plant(machine, setup).run(drive, lattices=False).channels["imu_z"]
        for setup in (Setup(), Setup(imu_pole_Hz=1.0 / (2.0 * np.pi * lag_s)))
    )
    slope = CubicSpline(np.arange(len(before)) / machine.rate_Hz, before)(np.arange(len(before)) / machine.rate_Hz, 1)
    assert -(after - before) @ slope / (slope @ slope) == pytest.approx(lag_s, rel=0.05)


def test_an_imu_reads_what_it_does_in_much_finer_steps(machines: dict[str, Machine], monkeypatch: pytest.MonkeyPatch) -> None:
    """Fast motion, which second differences weigh: a low pass that takes each step's input for a line errs by 1.3e-4 of it in the gyro."""
    from concealed.truth import plant
    from concealed.truth.experiments import Experiment, plan

    machine = machines["tilted_arm"]
    drive = plan(machine, Experiment("multisine", 3, duration_s=4.0))
    coarse = plant.Plant(machine, plant.Setup()).run(drive, lattices=False).channels
    monkeypatch.setattr(plant, "STEP_S", plant.STEP_S / 8.0)
    fine = plant.Plant(machine, plant.Setup()).run(drive, lattices=False).channels
    for name in ("imu_x", "imu_z", "gyro_y"):
        error, whole = (np.diff(values, 2) for values in (coarse[name] - fine[name], fine[name]))
        assert np.linalg.norm(error) < 1.1e-4 * np.linalg.norm(whole), name


@pytest.mark.parametrize(("frequency_Hz", "damping_ratio", "step_s"), [(14.0, 0.01, 3e-4), (14.0, 0.01, 9e-4), (4.0, 0.05, 9e-4)])
def test_an_added_mass_swings_and_decays_as_its_numbers_say(frequency_Hz: float, damping_ratio: float, step_s: float) -> None:
    """Against the closed form of a damped oscillator whose joint stands."""
    from concealed.truth import joint_physics

    w, mass = 2.0 * np.pi * frequency_Hz, 0.3
    row = [mass, mass * w * w, 2.0 * damping_ratio * w * mass]
    places = _of_a_standing_joint(joint_physics.ADDED_MODE, row, step_s, begun=1e-3)
    t, damped = step_s * np.arange(1, len(places) + 1), w * np.sqrt(1.0 - damping_ratio**2)
    decay = np.exp(-damping_ratio * w * t)
    expected = 1e-3 * decay * (np.cos(damped * t) + damping_ratio * w / damped * np.sin(damped * t))
    assert np.abs(places - expected).max() < 1e-3 * 0.01


def test_a_sloshing_mass_without_drag_loses_nothing_and_slows_as_a_pendulum_does() -> None:
    """A pendulum of amplitude A has 1 - A^2/16 of the frequency of a small one (Landau and Lifshitz, Mechanics, sec. 11)."""
    from concealed.truth import joint_physics

    w, swing, step_s = 2.0 * np.pi * 1.5, 0.05, 9e-4
    for begun, slower in ((1e-4, 0.0), (0.5 * swing, 0.5**2 / 16.0)):
        places = _of_a_standing_joint(joint_physics.SLOSH, [0.3, w, swing, 0.0], step_s, begun)
        crossings = np.flatnonzero((places[:-1] < 0.0) & (places[1:] >= 0.0))
        assert np.abs(places[-1000:]).max() == pytest.approx(begun, rel=2e-3)
        frequency = (len(crossings) - 1) / ((crossings[-1] - crossings[0]) * step_s)
        assert frequency == pytest.approx(w / (2.0 * np.pi) * (1.0 - slower), rel=2e-3)


def _of_a_standing_joint(kind: int, row: list[float], step_s: float, begun: float) -> np.ndarray:
    """Places of a mass on a joint that stands at zero, over five seconds."""
    from concealed.truth import joint_physics as physics

    parameters, states, none = np.zeros((1, physics.PARAMETERS)), np.zeros((1, physics.STATES)), np.zeros(1)
    parameters[0, : len(row)] = row
    states[0, 0] = begun
    kinds, joint = np.array([kind]), np.zeros(1, dtype=np.int64)
    places = []
    for _ in range(round(5.0 / step_s)):
        physics.add_efforts(kinds, joint, joint, parameters, states, none, none, none, 0.0, step_s, none, none, np.zeros(1), np.zeros(1))
        places.append(states[0, 0])
    return np.array(places)


def test_a_mass_that_is_carried_along_pulls_back_by_what_it_takes_to_accelerate_it() -> None:
    """At a constant acceleration of its joint, in the mean over whole cycles once it hardly swings."""
    from concealed.truth import joint_physics as physics

    mass, w, step_s, a = 0.3, 2.0 * np.pi * 5.0, 9e-4, 2.0
    for kind, row in ((physics.ADDED_MODE, [mass, mass * w * w, mass * w]), (physics.SLOSH, [mass, w, 10.0, 500.0])):
        parameters, states, kinds, joint = (
            np.zeros((1, physics.PARAMETERS)),
            np.zeros((1, physics.STATES)),
            np.array([kind]),
            np.zeros(1, int),
        )
        parameters[0, : len(row)] = row
        pulls = []
        for k in range(round(4.0 / step_s)):
            t, applied = (k + 0.5) * step_s, np.zeros(1)
            moved, speed = np.array([0.5 * a * t * t]), np.array([a * t])
            physics.add_efforts(
                kinds, joint, joint, parameters, states, moved, speed, speed, t, step_s, speed, speed, applied, applied.copy()
            )
            pulls.append(applied[0])
        assert np.mean(pulls[-round(1.0 / step_s) :]) == pytest.approx(-mass * a, rel=2e-3)


def test_two_poles_in_a_row_give_the_mean_of_what_they_do_in_a_step() -> None:
    """Against a thousandth of the step."""
    from concealed.truth.loop import through_poles

    whole, fine, step_s = np.array([0.3, -0.2]), np.array([0.3, -0.2]), 9e-4
    for target in (1.0, -0.5, 0.2):
        mean = through_poles(whole, target, 130.0, 200.0, step_s)
        inside = []
        for _ in range(1000):
            begun = fine[1]
            through_poles(fine, target, 130.0, 200.0, 1e-3 * step_s)
            inside.append(0.5 * (begun + fine[1]))
        assert mean == pytest.approx(np.mean(inside), abs=1e-6)
        assert whole == pytest.approx(fine, abs=1e-12)
        slopes = 2.0 * np.pi * np.array([130.0, 200.0]) * np.array([target - fine[0], fine[0] - fine[1]])
        moved = fine.copy()
        through_poles(moved, target, 130.0, 200.0, 1e-9)
        assert (moved - fine) / 1e-9 == pytest.approx(slopes, rel=1e-3)


def test_a_drives_poles_are_the_same_in_steps_of_a_third(machines: dict[str, Machine]) -> None:
    """A second pole that reads what the first gives at a step's end, as if it were the step's mean, lags by half a step too little."""
    from concealed.truth.catalogue import KINDS
    from concealed.truth.experiments import Experiment, plan
    from concealed.truth.plant import STEP_S, Plant, Setup

    machine, lag_s = machines["spring_mass"], 2e-3
    drive = plan(machine, Experiment("multisine", 3, duration_s=4.0))
    setup = Setup()
    KINDS["drive_bandwidth"].add(setup, machine, "cart", {"ratio": 1.5}, lag_s)
    effort, fine = (
        Plant(machine, setup).run(drive, lattices=False, longest_step_s=step).channels["effort_cart"] for step in (STEP_S, STEP_S / 3)
    )
    assert np.linalg.norm(effort - fine) < 1e-4 * np.linalg.norm(fine)


def test_what_shakes_a_machine_has_not_bent_it_before(machines: dict[str, Machine]) -> None:
    """A shake begins with the record: the integrator holds nothing of it at the start, whatever its phase."""
    from concealed.truth.catalogue import KINDS
    from concealed.truth.draw import Hidden, draw
    from concealed.truth.workshop import Chosen, Workshop

    case = next(case for number in range(200) if (case := draw(number, 4, machines)).machine == "slider" and not case.hidden)
    shop = Workshop(case, machines["slider"])
    shake = Hidden(KINDS["base_motion"], "carriage", {"f": 7.0, "phi": 1.5, "second": 0.0}, 1.0)
    still, shaken = (shop.answer(shop.setup(hidden), shop.training) for hidden in ((), (Chosen(shake, 0.5),)))
    assert shaken.controller_states == still.controller_states
    assert np.abs(shaken.channels["position_carriage"] - still.channels["position_carriage"]).max() > 1e-6

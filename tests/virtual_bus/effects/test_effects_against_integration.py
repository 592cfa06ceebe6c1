"""Effects on a block on a rail against equations integrated by SciPy, written here from the catalogue's text."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import scipy.signal
from scipy.integrate import solve_ivp
from small_plants import BLOCK_MASS_kg, block, run

from virtual_bus.errors import EffectError
from virtual_bus.linear.plant import linearised
from virtual_bus.physics import Physics
from virtual_bus.plant.compiled import compile_plant
from virtual_bus.settings import EffectSetting

PERIOD_s = 1.0 / 256.0
ROWS = 256
STIFFNESS, DAMPING = 150.0, 2.0
TIME_s = np.arange(ROWS) * PERIOD_s
FORCES = 9.0 * np.sin(2.0 * np.pi * 1.3 * TIME_s) + 2.0 * np.sin(2.0 * np.pi * 7.0 * TIME_s) + 1.0

M, K, D = BLOCK_MASS_kg, STIFFNESS, DAMPING
BRISTLE = {"Fc": 3.0, "Fs_minus_Fc": 1.0, "vs": 0.05, "sigma0": 4000.0, "sigma1": 5.0}
Extra = Callable[[float, float, float, np.ndarray], tuple[float, list[float]]]


def integrated(extra: Extra, memory: int = 0, inertia: float = M) -> np.ndarray:
    """Block positions (ROWS + 1,) of m x'' = force - k x - d x' + extra(t, x, v, z)[0], z' = extra(...)[1]."""
    y = np.zeros(2 + memory)
    rows = [y]
    for k, force in enumerate(FORCES):

        def motion(t: float, y: np.ndarray, force: float = force) -> list[float]:
            effort, rates = extra(t, y[0], y[1], y[2:])
            return [y[1], (force - K * y[0] - D * y[1] + effort) / inertia, *rates]

        y = solve_ivp(motion, (k * PERIOD_s, (k + 1) * PERIOD_s), y, rtol=1e-8, atol=1e-11, method="LSODA").y[:, -1]
        rows.append(y)
    return np.array(rows)[:, 0]


def mode(t: float, x: float, v: float, z: np.ndarray) -> tuple[float, list[float]]:
    w, zeta, j = 2.0 * np.pi * 4.0, 0.05, 0.4
    absolute = w * w * (x - z[0]) + 2.0 * zeta * w * (v - z[1])  # of the added mass, in absolute coordinates
    return -j * absolute, [z[1], absolute]


def lugre(t: float, x: float, v: float, z: np.ndarray) -> tuple[float, list[float]]:
    g = BRISTLE["Fc"] + BRISTLE["Fs_minus_Fc"] * np.exp(-((v / BRISTLE["vs"]) ** 2))
    rate = v - BRISTLE["sigma0"] * abs(v) * z[0] / g
    return -BRISTLE["sigma0"] * z[0] - BRISTLE["sigma1"] * rate, [rate]


def wen(t: float, x: float, v: float, z: np.ndarray) -> tuple[float, list[float]]:
    n, z_max, share, a = 1.5, 0.02, 0.7, 0.9
    total = a / z_max**n
    beta, gamma = share * total, (1.0 - share) * total
    return -200.0 * z[0], [a * v - beta * abs(v) * abs(z[0]) ** (n - 1.0) * z[0] - gamma * v * abs(z[0]) ** n]


def warming(t: float, x: float, v: float, z: np.ndarray) -> tuple[float, list[float]]:
    viscosity = 6.0 * np.exp(-0.1 * z[0])
    return -viscosity * v, [(20.0 * viscosity * v * v - z[0]) / 1.5]


def touching(t: float, x: float, v: float, z: np.ndarray) -> tuple[float, list[float]]:
    beyond = np.sign(x) * max(abs(x) - 0.01, 0.0)
    return -300.0 * (beyond - np.tanh(20.0 * beyond) / 20.0), []


def uneven(t: float, x: float, v: float, z: np.ndarray) -> tuple[float, list[float]]:
    """Of k2 = 900 N/m^2 and k3 = 4e4 N/m^3 that become straight at a twentieth of a metre: the integral of the slope 2 k2 s + 3 k3 s^2."""
    s = np.tanh(20.0 * x) / 20.0
    return -(2.0 * 900.0 * np.log(np.cosh(20.0 * x)) / 400.0 + 3.0 * 4e4 * (x - s) / 400.0), []


def commanded(t: float) -> float:
    return float(FORCES[min(int(t / PERIOD_s + 1e-9), ROWS - 1)])


def sagging(t: float, x: float, v: float, z: np.ndarray) -> tuple[float, list[float]]:
    """A motor of 1 ohm and 1 N/A behind a bridge, on 20 V through 2 ohm: what is missing of the command's effort."""
    duty = commanded(t) / 20.0
    current = (commanded(t) - 4.0 * v) / (1.0 + 2.0 * abs(duty))
    return current + 4.0 * v - commanded(t), []  # the back-EMF is in the plant's damper


CASES: dict[str, tuple[dict[str, float], Extra, int]] = {
    "viscous_friction": ({"Fv": 5.0}, lambda t, x, v, z: (-5.0 * v, []), 0),
    "quadratic_friction": ({"Fv2": 20.0}, lambda t, x, v, z: (-20.0 * v * abs(v), []), 0),
    "gravity_imbalance": ({"mgr": 30.0, "phi": 0.1}, lambda t, x, v, z: (-30.0 * np.sin(x + 0.1), []), 0),
    "cable_spring": (
        {"kc": 40.0, "kc3": 3e4, "theta0": 0.01},
        lambda t, x, v, z: (-40.0 * (x - 0.01) - 3e4 * (x - 0.01) ** 3, []),
        0,
    ),
    "constant_load": ({"tau0": -3.0}, lambda t, x, v, z: (-3.0, []), 0),
    "cogging": (
        {"Np": 60.0, "A1": 1.5, "phi1": 0.4, "A2": 0.5, "phi2": -0.2},
        lambda t, x, v, z: (1.5 * np.cos(60.0 * x + 0.4) + 0.5 * np.cos(120.0 * x - 0.2), []),
        0,
    ),
    "nonlinear_stiffness": ({"k3": 4e4, "bend": 400.0, "corner": 0.01, "k2": 0.0}, touching, 0),
    "nonlinear_stiffness one way": ({"k3": 4e4, "bend": 400.0, "corner": 0.0, "k2": 900.0}, uneven, 0),
    "nonlinear_stiffness of squares": (
        {"k3": 2e4, "bend": 0.0, "corner": 0.0, "k2": 900.0},
        lambda t, x, v, z: (-900.0 * x**2 - 2e4 * x**3, []),
        0,
    ),
    "position_dependent_damping": (
        {"D1": 30.0, "D2": 400.0, "A": 1.5, "k": 40.0, "phi": 0.3},
        lambda t, x, v, z: (-(30.0 * x + 400.0 * x**2 + 1.5 * np.cos(40.0 * x + 0.3)) * v, []),
        0,
    ),
    "supply_resistance": ({"sag": 2.0 / 20.0, "ke": 4.0}, sagging, 0),
    "backlash": ({"b": 0.01, "flank": 0.005}, lambda t, x, v, z: (STIFFNESS * np.clip(x / 1.5, -0.01, 0.01), []), 0),
    "end_stop": (
        {"K": 5000.0, "D": 10.0, "at_position": 0.03, "side": 1.0},
        lambda t, x, v, z: (-max(5000.0 * (x - 0.03) + 10.0 * v, 0.0) if x > 0.03 else 0.0, []),
        0,
    ),
    "base_motion": ({"A": 4.0, "f": 5.0, "phi": 0.3}, lambda t, x, v, z: (4.0 * np.sin(2.0 * np.pi * 5.0 * t + 0.3), []), 0),
    "torque_constant": ({"eps": 0.2}, lambda t, x, v, z: (0.2 * commanded(t), []), 0),
    "structural_mode": ({"J": 0.4, "f": 4.0, "zeta": 0.05}, mode, 2),
    "presliding_hysteresis": (BRISTLE, lugre, 1),
    "bouc_wen_hysteresis": ({"k": 200.0, "A": 0.9, "z_max": 0.02, "beta_share": 0.7, "n": 1.5}, wen, 1),
    "creep": ({"k1": 80.0, "tau": 0.3}, lambda t, x, v, z: (-80.0 * z[0], [v - z[0] / 0.3]), 1),
    "thermal_bending": (
        {"bend": 0.02, "tau": 0.4, "warm_for": 0.0},
        lambda t, x, v, z: (STIFFNESS * 0.02 * (1.0 - np.exp(-t / 0.4)), []),
        0,
    ),
    "temperature_dependent_friction": ({"Fv0": 6.0, "a": 0.1, "R": 20.0, "tau": 1.5}, warming, 1),
}


def positions(case: str, parameters: dict[str, float], substeps: int) -> np.ndarray:
    name = case.split()[0]
    at = "block" if name in ("payload", "nonlinear_stiffness", "backlash", "thermal_bending") else "rail"
    effect = EffectSetting(name, at, parameters)
    return run(block(stiffness=STIFFNESS, damping=DAMPING, effects=(effect,), substeps=substeps), FORCES[:, None])[:, 0]


@pytest.mark.parametrize("name", CASES)
def test_it_moves_as_its_equation_says_and_halving_the_step_converges(name: str) -> None:
    parameters, extra, memory = CASES[name]
    exact = integrated(extra, memory)
    scale = float(np.ptp(exact))
    errors = [float(np.abs(positions(name, parameters, substeps) - exact).max()) / scale for substeps in (4, 16, 64)]
    assert errors[2] < 5e-5
    assert errors[0] < 2e-2
    # 256 for second order; a contact that jumps in within a step is of first order, and SciPy's own error ends it
    assert errors[2] < 1e-6 or errors[0] / errors[2] > (4.0 if name == "end_stop" else 16.0)
    nothing = positions("constant_load", {"tau0": 0.0}, 16)
    assert np.abs(nothing - exact).max() > 0.01 * scale


@pytest.mark.parametrize(
    ("name", "parameters", "added"),
    [("payload", {"dm": 0.7}, 0.7), ("added_inertia", {"J": 0.7}, 0.7), ("added_inertia", {"J": -1.2}, -1.2)],
)
def test_what_is_added_is_inertia(name: str, parameters: dict[str, float], added: float) -> None:
    exact = integrated(lambda t, x, v, z: (0.0, []), inertia=M + added)
    np.testing.assert_allclose(positions(name, parameters, 16), exact, rtol=0, atol=1e-6 if added < 0.0 else 1e-7)


def test_an_added_inertia_that_takes_away_all_there_is_is_refused() -> None:
    with pytest.raises(EffectError, match="added_inertia"):
        compile_plant(block(effects=(EffectSetting("added_inertia", "rail", {"J": -1.01 * M}),))).model()


def test_a_motor_on_a_weak_supply_holds_a_weight_with_the_command_that_its_circuit_asks_for() -> None:
    """I = u / (1 + 2 u / 20) in the circuit of `sagging` at rest; no command gives 10 A or more."""
    acting = (EffectSetting("constant_load", "rail", {"tau0": -4.0}), EffectSetting("supply_resistance", "rail", {"sag": 0.1, "ke": 4.0}))
    physics = Physics(block(effects=acting), noise=False)
    command = physics.holding_effort(np.zeros(1))
    assert command[0] / (1.0 + 2.0 * command[0] / 20.0) == pytest.approx(4.0)
    physics.hold(command)
    physics.advance()
    assert physics.joint_speeds[0] == pytest.approx(0.0, abs=1e-12)
    assert physics.latch_exactly().effort[0] == pytest.approx(4.0)
    too_heavy = EffectSetting("constant_load", "rail", {"tau0": -10.5})
    assert Physics(block(effects=(too_heavy, acting[1])), noise=False).holding_effort(np.zeros(1))[0] == np.inf


def test_an_amplifier_s_limit_cuts_what_the_supply_gives() -> None:
    acting = (
        EffectSetting("current_saturation", "rail", {"imax": 5.0, "droop": 0.0}),
        EffectSetting("supply_resistance", "rail", {"sag": 0.1}),
    )
    for command, flows in ((9.0, 9.0 / 1.9), (20.0, 5.0)):
        physics = Physics(block(effects=acting), noise=False)
        physics.apply(np.array([command]))
        assert physics.latch_exactly().effort[0] == pytest.approx(flows)


def latched(
    effect: EffectSetting, forces: np.ndarray, group: str = "effort", stiffness: float = 0.0, *further: EffectSetting
) -> np.ndarray:
    """Readings of a free block, lattices off."""
    settings = block(stiffness=stiffness, effects=(effect, *further), substeps=16)
    settings = replace(settings, encoders=tuple(replace(encoder, resolution=0.0) for encoder in settings.encoders))
    physics = Physics(settings, noise=False)
    physics.set_brakes(np.zeros(1, dtype=bool))
    rows = []
    for force in forces:
        physics.apply(np.array([force]))
        rows.append(getattr(physics.latch(), group).copy())
        physics.advance()
    return np.array(rows)[:, 0]


def test_a_delay_of_two_and_a_half_samples_shifts_what_flows_and_what_moves() -> None:
    pulse = np.zeros(8)
    pulse[1] = 5.0
    effect = EffectSetting("delay", "rail", {"Td": 2.5 * PERIOD_s})
    np.testing.assert_array_equal(latched(effect, pulse), [0, 0, 0, 0, 5, 0, 0, 0])  # it flows from 3.5 to 4.5 samples, and so at SYNC 4
    moved = latched(effect, pulse, "position")
    assert moved[3] == 0.0
    assert moved[4] == pytest.approx(0.5 * 5.0 / M * (0.5 * PERIOD_s) ** 2, rel=1e-9)
    assert moved[5] == pytest.approx(0.5 * 5.0 / M * PERIOD_s**2 + 5.0 / M * PERIOD_s * 0.5 * PERIOD_s, rel=1e-9)


@pytest.mark.parametrize("rows", [1, 3, 7, 12])
def test_a_delay_of_whole_rows_is_whole_whatever_its_quotient_rounds_to(rows: int) -> None:
    """At a SYNC the new target flows, as it does without a delay, and not the one that has just ended."""
    pulse = np.zeros(16)
    pulse[1] = 5.0
    for delay_s in (rows * PERIOD_s, np.nextafter(rows * PERIOD_s, 1.0), np.nextafter(rows * PERIOD_s, 0.0)):
        got = latched(EffectSetting("delay", "rail", {"Td": float(delay_s)}), pulse)
        np.testing.assert_array_equal(got, np.roll(pulse, rows))


def test_the_current_answers_a_step_as_a_second_order_low_pass() -> None:
    w, zeta = 2.0 * np.pi * 20.0, 0.6
    wd = w * np.sqrt(1.0 - zeta**2)
    time_s = np.arange(40) * PERIOD_s
    expected = 3.0 * (1.0 - np.exp(-zeta * w * time_s) * (np.cos(wd * time_s) + zeta * w / wd * np.sin(wd * time_s)))
    got = latched(EffectSetting("drive_bandwidth", "rail", {"fc": 20.0, "zeta": zeta}), np.full(40, 3.0))
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("shape", [0.1, 0.25, 0.5])
def test_an_imu_answers_a_step_of_force_as_a_low_pass_of_second_order(shape: float) -> None:
    w = 2.0 * np.pi * 15.0
    step = scipy.signal.lti([1.0], [shape / w**2, 1.0 / w, 1.0]).step(T=np.arange(60) * PERIOD_s)[1]
    got = latched(EffectSetting("imu_bandwidth", "imu", {"fc": 15.0, "shape": shape}), np.full(60, 3.0), "imu")
    np.testing.assert_allclose(got, 3.0 / M * step, rtol=0, atol=1e-9)


def test_the_linear_plant_reads_its_imu_through_a_low_pass_of_second_order() -> None:
    effect = EffectSetting("imu_bandwidth", "imu", {"fc": 15.0, "shape": 0.3})
    responses = []
    for settings in (block(stiffness=STIFFNESS, bandwidth_Hz=0.0), block(stiffness=STIFFNESS, effects=(effect,))):
        system = linearised(compile_plant(settings), np.zeros(1)).state_space()
        responses.append(system[system.output_labels.index("imu_x"), 0](2j * np.pi * np.array([1.0, 12.0, 40.0])))
    s = 1j * np.array([1.0, 12.0, 40.0]) / 15.0
    np.testing.assert_allclose(responses[1], responses[0] / (1.0 + s + 0.3 * s**2), rtol=1e-6)


def test_a_saturated_current_is_what_flows_and_falls_with_speed() -> None:
    got = latched(EffectSetting("current_saturation", "rail", {"imax": 4.0, "droop": 2.0}), np.full(256, 9.0))
    expected = 4.0 * np.exp(-2.0 / M * np.arange(256) * PERIOD_s)  # m v' = imax - droop v
    np.testing.assert_allclose(got, expected, rtol=0, atol=2e-5)


def test_encoder_errors_are_functions_of_position_relative_to_an_incremental_start() -> None:
    true = latched(EffectSetting("constant_load", "rail", {"tau0": 0.0}), FORCES, "position")
    parameters = {"a": 0.01, "phi": 0.4, "b": 0.001, "Nl": 30.0}
    error = 0.01 * np.cos(true + 0.4) + 0.001 * np.cos(30.0 * true)
    incremental = latched(EffectSetting("encoder_eccentricity", "position_rail", parameters), FORCES, "position")
    absolute = latched(EffectSetting("encoder_eccentricity", "link_position_rail", parameters), FORCES, "link_position")
    np.testing.assert_allclose(incremental, true + error - error[0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(absolute, true + error, rtol=0, atol=1e-12)


def test_a_coarse_lattice_rounds_half_up() -> None:
    true = latched(EffectSetting("constant_load", "rail", {"tau0": 0.0}), FORCES, "position")
    got = latched(EffectSetting("encoder_quantization", "position_rail", {"q": 0.003}), FORCES, "position")
    np.testing.assert_allclose(got, 0.003 * np.floor(true / 0.003 + 0.5), rtol=0, atol=1e-15)


@pytest.mark.parametrize("samples", [0.3, 1.5, 4.0, 25.2])
def test_a_late_clock_reads_the_past_between_its_samples(samples: float) -> None:
    """Of what moves as slowly as a loop does."""
    t0, drift = samples * PERIOD_s, 0.01
    past = np.maximum(TIME_s - t0 - drift * TIME_s, 0.0)
    got = latched(EffectSetting("clock_offset", "effort_rail", {"t0": t0, "delta": drift}), FORCES)
    expected = 9.0 * np.sin(2.0 * np.pi * 1.3 * past) + 2.0 * np.sin(2.0 * np.pi * 7.0 * past) + 1.0
    moves = past > 3.0 * PERIOD_s  # between the first samples and what stood still before them nothing is known
    np.testing.assert_allclose(got[moves], expected[moves], rtol=0, atol=1e-3)
    np.testing.assert_array_equal(got[past == 0.0], np.full(np.sum(past == 0.0), FORCES[0]))


@pytest.mark.parametrize("group", ["position", "link_position"])
def test_an_axis_is_read_late_by_all_its_encoders_and_not_by_its_current(group: str) -> None:
    """And what one of them has besides is added."""
    late = EffectSetting("clock_offset", "rail", {"t0": 3.0 * PERIOD_s, "delta": 0.0})
    true = latched(EffectSetting("constant_load", "rail", {"tau0": 0.0}), FORCES, group)
    np.testing.assert_allclose(latched(late, FORCES, group), true[np.maximum(np.arange(ROWS) - 3, 0)], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(latched(late, FORCES), FORCES)
    further = EffectSetting("clock_offset", "link_position_rail", {"t0": 2.0 * PERIOD_s, "delta": 0.0})
    age = 5 if group == "link_position" else 3
    np.testing.assert_allclose(latched(late, FORCES, group, 0.0, further), true[np.maximum(np.arange(ROWS) - age, 0)], rtol=0, atol=1e-12)


@pytest.mark.parametrize(("samples", "read"), [(1.0, 1), (4.0, 4), (63.0, 63), (200.0, 63)])
def test_at_whole_samples_a_late_clock_reads_what_was_there(samples: float, read: int) -> None:
    """Of anything, and no older than it remembers."""
    forces = np.random.default_rng(5).normal(size=ROWS)
    got = latched(EffectSetting("clock_offset", "effort_rail", {"t0": samples * PERIOD_s, "delta": 0.0}), forces)
    np.testing.assert_allclose(got, forces[np.maximum(np.arange(ROWS) - read, 0)], rtol=0, atol=1e-12)


def test_lost_samples_repeat_the_last_reading_in_a_share_of_bursts() -> None:
    forces = np.arange(4096.0) % 97 / 10.0
    got = latched(EffectSetting("sample_dropout", "effort_rail", {"p": 0.25, "length": 4.0, "seed": 3.0}), forces)
    lost = got != forces
    assert lost[: 4096 // 4 * 4].reshape(-1, 4)[1:].std(axis=1).max() == 0.0  # whole bursts
    assert lost.mean() == pytest.approx(0.25, abs=0.05)
    held = got[np.flatnonzero(lost)]
    np.testing.assert_array_equal(held, got[np.flatnonzero(lost) - 1])


@pytest.mark.parametrize(("parameters", "shape"), [({"share": 1.0, "sign": 1.0}, np.abs), ({"share": 0.0, "sign": -1.0}, np.negative)])
def test_a_channel_loses_or_turns_its_sign(parameters: dict[str, float], shape: Callable) -> None:
    np.testing.assert_array_equal(latched(EffectSetting("rectified_sensor", "effort_rail", parameters), FORCES), shape(FORCES))

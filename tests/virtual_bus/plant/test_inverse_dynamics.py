"""A plant along a known motion, against oscillators in closed form, statistics of signs, and the plant's own inertia."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal
from small_plants import gantry

from virtual_bus.inverse_dynamics import along_module, mean_sign
from virtual_bus.plant.compiled import CompiledPlant, compile_plant
from virtual_bus.settings import Body, Drive, EffectSetting, Encoder, Joint, PlantSettings, Tree

PERIOD_s = 0.005
CART_kg, RIDER_kg, STIFFNESS, DAMPING = 4.0, 2.0, 2200.0, 3.0
ROWS = 400
X = np.array([1.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def pair() -> CompiledPlant:
    """A driven cart that carries a rider on a spring."""
    cart = Body("cart", "world", np.zeros(3), np.eye(3), CART_kg, np.zeros(3), 0.1 * np.eye(3), Joint("cart", "prismatic", X, 0.0, 9.0))
    spring = Joint("rider", "prismatic", X, STIFFNESS, DAMPING)
    rider = Body("rider", "cart", np.zeros(3), np.eye(3), RIDER_kg, np.zeros(3), 0.1 * np.eye(3), spring)
    return compile_plant(
        PlantSettings(
            tree=Tree((cart, rider), np.array([0.0, 0.0, -9.81])),
            drives=(Drive("cart", "cart", "N", 1.0, 1.0, 60.0, 0.0, 60.0),),
            encoders=(Encoder("position_cart", ("cart",), 0.0, absolute=True),),
            currents=(), imus=(), thermometers=(), sample_period_s=PERIOD_s, substeps=1,
        )
    )  # fmt: skip


def motion() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, speeds and accelerations (ROWS, 2) of a cart whose acceleration is linear between rows; the rider's are zero."""
    acceleration = np.cos(2.0 * np.pi * 2.0 * PERIOD_s * np.arange(ROWS))
    jerk = np.diff(acceleration) / PERIOD_s
    speed = np.append(0.0, np.cumsum(PERIOD_s * acceleration[:-1] + PERIOD_s**2 / 2 * jerk))
    steps = PERIOD_s * speed[:-1] + PERIOD_s**2 / 2 * acceleration[:-1] + PERIOD_s**3 / 6 * jerk
    position = np.append(0.0, np.cumsum(steps))
    cart = (position, speed, acceleration)
    return tuple(np.column_stack([each, np.zeros(ROWS)]) for each in cart)  # type: ignore[return-value]


def test_a_carried_joint_is_an_oscillator_on_a_moving_base(pair: CompiledPlant) -> None:
    q, v, a = motion()
    assert along_module(pair).carry(pair.model(), pair.new_work(), np.array([False, True]), 4, q, v, a)
    oscillator = (
        np.array([[0.0, 1.0], [-STIFFNESS / RIDER_kg, -DAMPING / RIDER_kg]]), np.array([[0.0], [-1.0]]), np.eye(2), np.zeros((2, 1)),
    )  # fmt: skip
    _, exact, _ = scipy.signal.lsim(oscillator, a[:, 0], PERIOD_s * np.arange(ROWS), interp=True)
    np.testing.assert_allclose(q[:, 1], exact[:, 0], atol=2e-7)
    np.testing.assert_allclose(v[:, 1], exact[:, 1], atol=1e-5)


def test_what_a_motion_takes_is_mass_times_acceleration_springs_and_dampers(pair: CompiledPlant) -> None:
    q, v, a = motion()
    module, model, work = along_module(pair), pair.model(), pair.new_work()
    module.carry(model, work, np.array([False, True]), 4, q, v, a)
    needed = np.zeros((ROWS, 2))
    module.efforts(model, work, q, v, a, needed)
    np.testing.assert_allclose(needed[:, 0], (CART_kg + RIDER_kg) * a[:, 0] + RIDER_kg * a[:, 1] + 9.0 * v[:, 0], rtol=1e-9)
    np.testing.assert_allclose(needed[:, 1], 0.0, atol=1e-9)  # nothing drives the rider


def test_friction_is_its_mean_over_the_way_from_row_to_row(pair: CompiledPlant) -> None:
    effects = (EffectSetting("coulomb_friction", "cart", {"Fc": 2.0}),)
    q, v = np.zeros((4, 2)), np.zeros((4, 2))
    v[:, 0] = [0.3, -0.1, -0.2, -0.2]
    rubbed = np.zeros((4, 2))
    along_module(pair).rub(
        pair.model(None, effects), pair.new_work(), q, v, np.full((4, 2), 1e-9), np.zeros((4, 2)), rubbed, np.zeros((4, 2))
    )
    np.testing.assert_allclose(rubbed[:3, 0], [2.0 * 0.5, -2.0, -2.0], atol=1e-6)  # three quarters of the way forwards


def test_friction_of_a_motor_is_a_share_of_its_effort_less_the_joints_damper(pair: CompiledPlant) -> None:
    effects = (EffectSetting("motor_load_friction", "cart", {"Km": 0.2}),)
    q, v, efforts, rubbed = (np.zeros((4, 2)) for _ in range(4))
    v[:, 0], efforts[:, 0] = [0.3, 0.3, -0.3, -0.3], [5.0, -5.0, 5.0, 5.0]
    along_module(pair).rub(pair.model(None, effects), pair.new_work(), q, v, np.full((4, 2), 1e-9), efforts, rubbed, np.zeros((4, 2)))
    np.testing.assert_allclose(rubbed[[0, 2], 0], [0.2 * (5.0 - 9.0 * 0.3), -0.2 * (5.0 + 9.0 * 0.3)], atol=1e-6)
    np.testing.assert_allclose(rubbed[:, 1], 0.0)


def test_friction_behind_a_spring_is_a_share_of_what_the_spring_transmits(pair: CompiledPlant) -> None:
    effects = (EffectSetting("motor_load_friction", "rider", {"Km": 0.2}),)
    q, v, efforts, rubbed = (np.zeros((4, 2)) for _ in range(4))
    v[:, 1], q[:, 1] = [0.3, 0.3, -0.3, -0.3], [0.01, 0.01, 0.02, 0.02]
    along_module(pair).rub(pair.model(None, effects), pair.new_work(), q, v, np.full((4, 2), 1e-9), efforts, rubbed, np.zeros((4, 2)))
    transmitted = [STIFFNESS * 0.01 + DAMPING * 0.3, STIFFNESS * 0.02 - DAMPING * 0.3]
    np.testing.assert_allclose(rubbed[[0, 2], 1], [0.2 * transmitted[0], -0.2 * transmitted[1]], atol=1e-6)
    np.testing.assert_allclose(rubbed[:, 0], 0.0)


def test_a_gear_rubs_by_its_motor_and_its_load(pair: CompiledPlant) -> None:
    """A load of 4 N towards positive position asks the drive for -4 N."""
    shares = {"Km": 0.2, "Kg": 0.1, "Km_rest": 0.3, "Kg_rest": 0.0, "vs": 0.1, "delta": 1.0}
    acting = (EffectSetting("constant_load", "cart", {"tau0": 4.0}), EffectSetting("transmitted_load_friction", "cart", shares))
    q, v, efforts, rubbed = (np.zeros((2, 2)) for _ in range(4))
    v[:, 0], efforts[:, 0] = 0.3, 5.0
    along_module(pair).rub(pair.model(None, acting), pair.new_work(), q, v, np.full((2, 2), 1e-9), efforts, rubbed, np.zeros((2, 2)))
    motor = 5.0 - 9.0 * 0.3
    assert rubbed[0, 0] == pytest.approx(abs(0.2 * motor - 0.1 * 4.0) + 0.3 * abs(motor) * np.exp(-3.0), abs=1e-6)


def test_a_motion_takes_added_inertia_and_damping_that_varies_on_top(pair: CompiledPlant) -> None:
    damping = {"D1": 3.0, "D2": 20.0, "A": 2.0, "k": 50.0, "phi": 0.4}
    added = (EffectSetting("added_inertia", "cart", {"J": 0.7}), EffectSetting("position_dependent_damping", "cart", damping))
    q, v, a = motion()
    module, work, needed = along_module(pair), pair.new_work(), np.zeros((2, ROWS, 2))
    for model, out in zip((pair.model(), pair.model(None, added)), needed, strict=True):
        module.efforts(model, work, q, v, a, out)
    x = q[:, 0]
    expected = 0.7 * a[:, 0] + (3.0 * x + 20.0 * x**2 + 2.0 * np.cos(50.0 * x + 0.4)) * v[:, 0]
    np.testing.assert_allclose(needed[1, :, 0] - needed[0, :, 0], expected, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(needed[1, :, 1], needed[0, :, 1])


def test_what_flows_from_a_weak_supply_along_a_motion_solves_the_motor_s_circuit(pair: CompiledPlant) -> None:
    """R i + abs(u) / U Rs i = u - ke v, of R = 1 ohm, Rs = 2 ohm and U = 20 V; what acts is R i + ke v."""
    acting = (EffectSetting("supply_resistance", "cart", {"sag": 2.0 / 20.0, "ke": 4.0}),)
    q, v, a = motion()
    targets = 9.0 * np.cos(np.arange(ROWS) / 30.0)[:, None]
    currents, efforts = np.zeros((ROWS, 1)), np.zeros((ROWS, 2))
    state = pair.new_state(q[0])
    along_module(pair).drive(pair.model(None, acting), pair.new_work(), targets, q, v, a, state, currents, efforts)
    u, speed = targets[:, 0], v[:, 0]
    flowing = (u - 4.0 * speed) / (1.0 + 2.0 * np.abs(u) / 20.0)
    np.testing.assert_allclose(currents[:, 0], flowing + 4.0 * speed, rtol=1e-12)
    middle = speed + 0.5 * PERIOD_s * a[:, 0]
    np.testing.assert_allclose(efforts[:, 0], (u - 4.0 * middle) / (1.0 + 2.0 * np.abs(u) / 20.0) + 4.0 * middle, rtol=1e-9)


@pytest.mark.parametrize(("start", "end", "deviation"), [(0.3, -0.1, 0.05), (0.02, 0.021, 0.05), (-0.2, -0.1, 0.3), (0.0, 0.0, 0.1)])
def test_the_mean_sign_is_that_of_drawn_speeds(start: float, end: float, deviation: float) -> None:
    rng = np.random.default_rng(2)
    drawn = start + (end - start) * rng.uniform(size=400_000) + rng.normal(0.0, deviation, 400_000)
    mean = mean_sign.py_func(start, end, deviation)  # type: ignore[attr-defined]
    assert mean == pytest.approx(np.mean(np.sign(drawn)), abs=5e-3)


def test_the_linearisation_is_that_of_inertia_and_bias() -> None:
    plant = compile_plant(gantry(substeps=1))
    rng = np.random.default_rng(3)
    q, v, a = (0.2 * rng.normal(size=(5, plant.joints)) for _ in range(3))
    n, model = plant.joints, plant.model()
    squares = [np.zeros((5, n, n)) for _ in range(3)]
    gradients = [np.zeros((5, 0, n)) for _ in range(3)]
    along_module(plant).linearise(model, plant.new_work(), q, v, a, *squares, *gradients)

    def taken(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        inertia, bias = plant.inertia_and_bias(model, q, v)
        springs = model["stiffness"][0] * (q - model["rest_position"][0]) + model["damping"][0] * v
        effort: np.ndarray = (inertia @ a[..., None])[..., 0] + bias + springs
        return effort

    np.testing.assert_allclose(squares[0], np.linalg.inv(plant.inertia_and_bias(model, q, v)[0]), rtol=1e-9)
    for joint in range(n):
        step = 1e-5 * np.eye(n)[joint]
        np.testing.assert_allclose(squares[1][:, :, joint], (taken(q + step, v) - taken(q - step, v)) / 2e-5, rtol=1e-5, atol=1e-4)
        np.testing.assert_allclose(squares[2][:, :, joint], (taken(q, v + step) - taken(q, v - step)) / 2e-5, rtol=1e-5, atol=1e-4)

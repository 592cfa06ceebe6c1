"""Plants small enough to know the answer: a block on a rail, a pendulum on a gantry."""

from __future__ import annotations

import numpy as np

from virtual_bus.settings import Body, CurrentSensor, Drive, EffectSetting, Encoder, Imu, Joint, PlantSettings, Thermometer, Tree

GRAVITY = np.array([0.0, 0.0, -9.81])
BLOCK_MASS_kg = 2.0


def block(
    *, mass_kg: float = BLOCK_MASS_kg, stiffness: float = 0.0, damping: float = 0.0, brake_effort: float = 50.0,
    bandwidth_Hz: float = 40.0, substeps: int = 4, effects: tuple[EffectSetting, ...] = (), noise: float = 0.0, resolution: float = 0.0,
) -> PlantSettings:  # fmt: skip
    """One mass on a rail, pushed in newtons, with every kind of sensor."""
    joint = Joint("rail", "prismatic", np.array([1.0, 0, 0]), stiffness, damping, brake_effort=brake_effort)
    body = Body("block", "world", np.zeros(3), np.eye(3), mass_kg, np.zeros(3), 0.01 * np.eye(3), joint)
    imu = Imu(
        "imu", "block", np.zeros(3), np.eye(3), np.full(3, noise), np.zeros(3), bandwidth_Hz, resolution, np.full(3, noise), np.zeros(3),
        bandwidth_Hz, resolution,
    )  # fmt: skip
    return PlantSettings(
        tree=Tree((body,), GRAVITY),
        drives=(Drive("rail", "rail", "N", constant=1.0, ratio=1.0, limit=100.0, resolution=0.0, rated=100.0),),
        encoders=(
            Encoder("position_rail", ("rail",), 1e-4, absolute=False),
            Encoder("link_position_rail", ("rail",), 2e-4, absolute=True),
        ),
        currents=(CurrentSensor("effort_rail", "rail", resolution, noise),),
        imus=(imu,),
        thermometers=(Thermometer("temperature_rail", "rail", 20.0, 0.5, 3.0, 0.0),),
        sample_period_s=1.0 / 256.0,
        substeps=substeps,
        watched_bodies=("block",),
        effects=effects,
    )


def gantry(substeps: int = 4) -> PlantSettings:
    """A driven cart, a sprung slide across it, a skewed lifting slide, and a pendulum hanging from that."""
    tilt = np.array([0.0, 0.6, 0.8])
    turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    bodies = (
        Body("cart", "world", np.zeros(3), np.eye(3), 8.0, np.zeros(3), 0.2 * np.eye(3),
             Joint("cart", "prismatic", np.array([1.0, 0, 0]), 60.0, 5.0)),
        Body("slide", "cart", np.array([0, 0, 0.1]), turned, 3.0, np.array([0.1, 0, 0]), 0.1 * np.eye(3),
             Joint("slide", "prismatic", np.array([1.0, 0, 0]), 900.0, 2.0, rest_position=0.05)),
        Body("bracket", "slide", np.array([0.2, 0.0, 0.0]), np.eye(3), 0.5, np.zeros(3), 0.01 * np.eye(3)),
        Body("lift", "bracket", np.array([0.0, 0.1, 0.0]), np.eye(3), 2.0, np.array([0.0, 0.1, 0.2]), np.diag([0.05, 0.04, 0.03]),
             Joint("lift", "prismatic", tilt, 4000.0, 10.0, armature=0.7)),
        Body("bob", "lift", np.array([0.0, 0.0, -0.1]), np.eye(3), 1.5, np.array([0.0, 0.05, -0.4]), np.diag([0.02, 0.02, 0.005]),
             Joint("swing", "revolute", np.array([1.0, 0, 0]), 0.5, 0.05)),
    )  # fmt: skip
    return PlantSettings(
        tree=Tree(bodies, GRAVITY),
        drives=(Drive("cart", "cart", "V", constant=4.0, ratio=2.0, limit=50.0, resolution=0.0, rated=10.0),),
        encoders=(Encoder("position_cart", ("cart",), 0.0, absolute=False),),
        currents=(), imus=(), thermometers=(), sample_period_s=1.0 / 256.0, substeps=substeps, watched_bodies=("bob",),
    )  # fmt: skip


def run(settings: PlantSettings, efforts: np.ndarray, start: np.ndarray | None = None, brakes: np.ndarray | None = None) -> np.ndarray:
    """Plant states (N + 1, state_size) under efforts (N, axes) held over each sample, from `start` (zeros by default)."""
    from virtual_bus.plant.compiled import compile_plant

    plant = compile_plant(settings)
    model, work = plant.model(), plant.new_work()
    state = np.zeros(plant.state_size)
    if start is not None:
        state[: len(start)] = start
    closed = np.zeros(len(settings.drives)) if brakes is None else brakes
    states = [state.copy()]
    for effort in efforts:
        plant.advance(state, effort, closed, model, work)
        states.append(state.copy())
    return np.array(states)

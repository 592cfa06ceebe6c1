"""A motor that turns with two axes: its friction in closed form on two slides, and MuJoCo's tendon on an arm of two links."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from small_plants import GRAVITY, run

from virtual_bus.inverse_dynamics import along_module
from virtual_bus.plant.compiled import compile_plant
from virtual_bus.settings import Body, Drive, EffectSetting, Encoder, Joint, PlantSettings, Tree

PERIOD_s = 1.0 / 256.0
FIRST_kg, SECOND_kg = 3.0, 2.0
LEVEL, SHARE = 4.0, 0.5


def settings(bodies: tuple[Body, ...], effects: tuple[EffectSetting, ...], substeps: int = 1) -> PlantSettings:
    names = [body.joint.name for body in bodies if body.joint is not None]
    unit = "N" if bodies[0].joint is not None and bodies[0].joint.kind == "prismatic" else "Nm"
    return PlantSettings(
        tree=Tree(bodies, GRAVITY),
        drives=tuple(Drive(name, name, unit, constant=1.0, ratio=1.0, limit=100.0, resolution=0.0, rated=100.0) for name in names),
        encoders=tuple(Encoder(f"position_{name}", (name,), 0.0, absolute=False) for name in names),
        currents=(), imus=(), thermometers=(), sample_period_s=PERIOD_s, substeps=substeps, effects=effects,
    )  # fmt: skip


def slides(level: float = LEVEL, slope: float = 0.0, further: tuple[EffectSetting, ...] = ()) -> PlantSettings:
    """Two masses beside each other, which nothing couples but the motor of the second."""
    masses = (("first", FIRST_kg), ("second", SECOND_kg))
    bodies = tuple(
        Body(name, "world", np.zeros(3), np.eye(3), mass, np.zeros(3), np.eye(3), Joint(name, "prismatic", np.array([1.0, 0, 0])))
        for name, mass in masses
    )
    return settings(bodies, (EffectSetting("shared_motor_friction", "first", {"Fc": level, "Fv": slope, "c": SHARE}), *further))


def pushed(plant: PlantSettings, first: float, second: float, rows: int = 128) -> np.ndarray:
    """Speeds (rows + 1, 2) from rest."""
    return run(plant, np.tile([first, second], (rows, 1)))[:, 2:4]


def test_it_takes_its_level_off_the_second_axis_and_its_share_off_the_first() -> None:
    end_s = 128 * PERIOD_s
    np.testing.assert_allclose(
        pushed(slides(), 5.0, 6.0)[-1], [(5.0 - SHARE * LEVEL) / FIRST_kg * end_s, (6.0 - LEVEL) / SECOND_kg * end_s], rtol=1e-9
    )
    np.testing.assert_allclose(  # the first axis alone turns the motor too, and drags the second one along against its push
        pushed(slides(), -60.0, 0.0)[-1], [(-60.0 + SHARE * LEVEL) / FIRST_kg * end_s, LEVEL / SECOND_kg * end_s], rtol=1e-9
    )


def test_a_motor_that_sticks_leaves_both_axes_the_motion_that_does_not_turn_it() -> None:
    first, second = 3.0, 2.0
    held = (second / SECOND_kg + SHARE * first / FIRST_kg) / (1.0 / SECOND_kg + SHARE**2 / FIRST_kg)
    assert abs(held) < LEVEL
    speeds = pushed(slides(), first, second)
    end_s = 128 * PERIOD_s
    np.testing.assert_allclose(speeds[-1], [(first - SHARE * held) / FIRST_kg * end_s, (second - held) / SECOND_kg * end_s], rtol=1e-9)
    np.testing.assert_allclose(speeds[:, 1] + SHARE * speeds[:, 0], 0.0, atol=1e-12)


def test_where_both_axes_rub_too_all_three_hold_what_they_can_together() -> None:
    own = tuple(EffectSetting("coulomb_friction", axis, {"Fc": 1.0}) for axis in ("first", "second"))
    plant = slides(further=own)
    most = LEVEL * np.array([SHARE, 1.0]) + 1.0
    assert np.abs(pushed(plant, *(0.98 * most))).max() < 1e-6
    assert pushed(plant, *(1.02 * most))[-1].min() > 1e-3


def test_its_viscous_part_damps_the_motors_speed() -> None:
    slope = 3.0
    inverse = np.diag([1.0 / FIRST_kg, 1.0 / SECOND_kg])
    along = np.array([SHARE, 1.0])
    speeds, force = np.zeros(2), np.array([5.0, 6.0])
    fine = 64
    for _ in range(128 * fine):  # midpoint rule
        middle = speeds + 0.5 * PERIOD_s / fine * inverse @ (force - along * (slope * along @ speeds))
        speeds = speeds + PERIOD_s / fine * inverse @ (force - along * (slope * along @ middle))
    np.testing.assert_allclose(pushed(slides(level=0.0, slope=slope), *force)[-1], speeds, rtol=2e-4)


def test_along_a_known_motion_it_is_what_both_drives_give_more() -> None:
    plant = compile_plant(slides(slope=2.0))
    position, efforts, mean, variance = (np.zeros((3, 2)) for _ in range(4))
    speed = np.tile([0.4, -0.1], (3, 1))  # the motor turns with -0.1 + 0.5 x 0.4
    module = along_module(plant)
    module.rub(plant.model(), plant.new_work(), position, speed, np.full((3, 2), 1e-9), efforts, mean, variance)
    np.testing.assert_allclose(mean, np.tile((LEVEL + 2.0 * 0.1) * np.array([SHARE, 1.0]), (3, 1)), rtol=1e-9)
    np.testing.assert_allclose(variance, 0.0, atol=1e-9)
    module.rub(plant.model(), plant.new_work(), position, 0.0 * speed, np.full((3, 2), 1e-3), efforts, mean, variance)
    np.testing.assert_allclose(mean, 0.0, atol=1e-9)
    np.testing.assert_allclose(variance, np.tile(LEVEL**2 * np.array([SHARE**2, 1.0]), (3, 1)), rtol=1e-9)


ARM = """
<mujoco>
  <option timestep="{step}" gravity="0 0 -9.81" integrator="implicitfast" iterations="200" tolerance="1e-14"/>
  <compiler angle="radian" inertiafromgeom="false"/>
  <worldbody>
    <body name="upper"><joint name="first" type="hinge" axis="0 1 0"/>
      <inertial pos="0.1 0 0.05" mass="2" diaginertia="0.02 0.03 0.03"/>
      <body name="lower" pos="0.3 0 0"><joint name="second" type="hinge" axis="0 1 0"/>
        <inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.02 0.02"/></body></body>
  </worldbody>
  <tendon><fixed name="motor" frictionloss="{level}" damping="{slope}" solimpfriction="0.9999 0.9999 0.001" solreffriction="0.0005 1">
    <joint joint="first" coef="{share}"/><joint joint="second" coef="1"/></fixed></tendon>
  <actuator><motor joint="first"/><motor joint="second"/></actuator>
</mujoco>"""


def link(name: str, parent: str, at_m: float, mass_kg: float, center_m: list[float], inertia: list[float], joint: str) -> Body:
    turning = Joint(joint, "revolute", np.array([0.0, 1.0, 0.0]))
    return Body(name, parent, np.array([at_m, 0.0, 0.0]), np.eye(3), mass_kg, np.array(center_m), np.diag(inertia), turning)


@pytest.mark.parametrize("share", [1.0, -0.6])
def test_an_arm_moves_as_with_a_tendon_of_mujoco_that_rubs(share: float) -> None:
    level, slope, rows, steps = 0.8, 0.3, 512, 40
    time_s = PERIOD_s * np.arange(rows)
    efforts = np.column_stack([8.0 * np.sin(9.0 * time_s), 3.0 * np.sin(14.0 * time_s)])
    model = mujoco.MjModel.from_xml_string(ARM.format(step=PERIOD_s / steps, level=level, slope=slope, share=share))
    data = mujoco.MjData(model)
    theirs = np.zeros((rows, 2))
    for k, effort in enumerate(efforts):
        data.ctrl[:] = effort
        for _ in range(steps):
            mujoco.mj_step(model, data)
        theirs[k] = data.qpos
    bodies = (
        link("upper", "world", 0.0, 2.0, [0.1, 0.0, 0.05], [0.02, 0.03, 0.03], "first"),
        link("lower", "upper", 0.3, 1.0, [0.1, 0.0, 0.0], [0.01, 0.02, 0.02], "second"),
    )
    effect = EffectSetting("shared_motor_friction", "first", {"Fc": level, "Fv": slope, "c": share})
    ours = run(settings(bodies, (effect,), substeps=steps), efforts)[1:, :2]
    without = run(settings(bodies, (), substeps=steps), efforts)[1:, :2]
    largest = np.abs(theirs).max()
    assert np.abs(ours - theirs).max() < 5e-3 * largest
    assert np.abs(without - theirs).max() > 0.1 * largest

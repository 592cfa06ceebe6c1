"""Which names the oracle asks for: what imitates an effect is refitted in the truth's own simulator, with the machine file's numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

if TYPE_CHECKING:
    from concealed.truth.apart import Measure
    from concealed.truth.plant import Machine
    from concealed.truth.workshop import Workshop

pytestmark = pytest.mark.nightly


@pytest.fixture
def chosen_of() -> Callable[..., object]:
    """(kind, place, shape, strength) as hidden physics."""
    from concealed.truth.catalogue import KINDS
    from concealed.truth.draw import Hidden
    from concealed.truth.workshop import Chosen

    return lambda name, place, shape, strength: Chosen(Hidden(KINDS[name], place, shape, 1.0), strength)


def a_shop(machines: dict[str, Machine], name: str, noise: float = 0.01) -> tuple[Workshop, Measure]:
    """Of a case that hides nothing, with noise of this share of every channel."""
    from concealed.truth.apart import Measure
    from concealed.truth.draw import draw
    from concealed.truth.oracle import NoiseUnits
    from concealed.truth.workshop import Workshop

    case = next(case for number in range(200) if (case := draw(number, 4, machines)).machine == name and not case.hidden)
    shop = Workshop(case, machines[name])
    base = shop.matrix(shop.setup(()), shop.training)
    size = np.where(base.std(axis=0) > 1e-9, noise * base.std(axis=0), 1.0)
    return shop, Measure(shop, NoiseUnits(np.random.default_rng(0).normal(size=(3, *base.shape)) * size))


def test_an_imu_read_late_imitates_one_with_a_fast_second_pole(machines: dict[str, Machine], chosen_of: Callable[..., object]) -> None:
    """Half a millisecond does the same either way but for (lag times frequency)^2 / 2."""
    from concealed.truth.apart import apart

    shop, measure = a_shop(machines, "tilted_arm")
    measure.numbers = {}
    found = apart(shop, (chosen_of("imu_bandwidth", "imu", {}, 5e-4),), 0, measure)
    assert found["detectability"] > 50.0
    assert min(found["distances"].values()) < 0.05 * found["detectability"]


@pytest.mark.parametrize(("late_s", "asked"), [(2e-5, False), (5e-4, True)])
def test_a_gyro_may_be_as_late_as_its_low_pass_may_be_off(
    machines: dict[str, Machine], chosen_of: Callable[..., object], late_s: float, asked: bool
) -> None:
    """2 % of 60 Hz delay by 53 us, which no recording tells from a clock's 20."""
    from concealed.truth.apart import apart

    shop, measure = a_shop(machines, "tilted_arm", noise=1e-3)
    late = chosen_of("clock_offset", "gyro_y", {"drift": 0.0}, late_s)
    found = apart(shop, (late,), 0, measure)
    assert (found["detectability"] > 5.0) is asked
    measure.numbers = {}
    assert apart(shop, (late,), 0, measure)["detectability"] > 5.0


def test_an_imitator_has_the_strength_that_imitates_best(machines: dict[str, Machine], chosen_of: Callable[..., object]) -> None:
    """A friction twenty times as strong, scaled down, sticks longer than a weak one and looks unlike it."""
    from concealed.truth.apart import apart
    from concealed.truth.catalogue import KINDS

    shop, measure = a_shop(machines, "slider")
    measure.numbers = {}
    weak = 0.05 * KINDS["asymmetric_friction"].typical(shop.machine, "carriage")
    found = apart(shop, (chosen_of("asymmetric_friction", "carriage", {"ratio": 0.999}, weak),), 0, measure)
    assert found["distances"]["coulomb_friction"] < 0.02 * found["detectability"]


def test_an_effect_is_asked_for_by_what_it_does_beside_the_others(machines: dict[str, Machine], chosen_of: Callable[..., object]) -> None:
    """A joint that a friction slows down passes its cogs otherwise."""
    from concealed.truth.apart import apart
    from concealed.truth.catalogue import KINDS
    from concealed.truth.oracle import left_over

    shop, measure = a_shop(machines, "slider")
    measure.numbers = {}
    strengths = {"stribeck_friction": 4.0, "cogging": 0.3}
    shapes = {name: KINDS[name].draw(np.random.default_rng(0), shop.machine, "carriage") for name in strengths}
    typical = {name: KINDS[name].typical(shop.machine, "carriage") for name in strengths}
    first, second = (chosen_of(name, "carriage", shapes[name], times * typical[name]) for name, times in strengths.items())
    stronger = replace(first, strength=1.01 * first.strength)
    faster = replace(first, hidden=replace(first.hidden, shape=first.hidden.shape | {"speed": 1.01 * first.hidden.shape["speed"]}))
    some = (), (first, second), (first,), (second,), (stronger, second), (faster, second)
    nothing, both, one, other, more, wider = (measure(shop.matrix(shop.setup(hidden), shop.training)) for hidden in some)
    found = apart(shop, (first, second), 1, measure)["detectability"]
    assert found == pytest.approx(left_over(both - one, [more - both, wider - both]), rel=0.02)
    assert found != pytest.approx(left_over(other - nothing, [one - nothing]), rel=0.1)


def test_a_drives_lag_is_asked_for_by_what_it_does_beyond_a_current_read_late(
    machines: dict[str, Machine], chosen_of: Callable[..., object]
) -> None:
    """A lag of nothing reads the current before the command that has just come: one sample late, and everything else as it was."""
    from concealed.truth.apart import apart

    shop, measure = a_shop(machines, "tilted_arm")
    measure.numbers = {}
    found = [apart(shop, (chosen_of("drive_bandwidth", "arm", {"ratio": 1.5}, lag_s),), 0, measure) for lag_s in (1e-6, 3e-4)]
    assert all(one["detectability"] > 500.0 for one in found)
    assert [one["separable"] for one in found] == [False, True]


def test_beside_an_encoders_lattice_an_effect_does_what_it_does_without(
    machines: dict[str, Machine], chosen_of: Callable[..., object]
) -> None:
    """Rounding goes around the loop: the errors of two simulations with a lattice have nothing in common, however little the simulations
    differ. So distances are those of simulations without it.
    """
    from concealed.truth.apart import apart
    from concealed.truth.catalogue import KINDS

    shop, measure = a_shop(machines, "tilted_arm")
    measure.numbers = {}
    friction = chosen_of("viscous_friction", "arm", {}, 0.02 * KINDS["viscous_friction"].typical(shop.machine, "arm"))
    lattice = chosen_of("encoder_quantization", "arm", {"least": 3e-5}, 3e-5)
    alone, beside = (apart(shop, hidden, 0, measure)["detectability"] for hidden in ((friction,), (friction, lattice)))
    assert beside == pytest.approx(alone, rel=1e-6)


@pytest.mark.parametrize(
    ("name", "hidden", "by"),
    [
        ("slider", "stribeck_friction", "strengths alone"),
        ("tilted_arm", "nonlinear_stiffness", "strengths alone"),
        ("slider", "stribeck_friction", "numbers too, by simulations"),
    ],
)
def test_in_coarse_steps_imitators_stand_as_far_from_the_truth_as_in_its_own(
    machines: dict[str, Machine], chosen_of: Callable[..., object], monkeypatch: pytest.MonkeyPatch, name: str, hidden: str, by: str
) -> None:
    from concealed.truth import apart as oracle
    from concealed.truth import workshop
    from concealed.truth.catalogue import KINDS

    def found() -> dict[str, bool | dict[str, float] | float]:
        shop, measure = a_shop(machines, name)
        if by == "strengths alone":
            measure.numbers = {}
        kind = KINDS[hidden]
        place = next(iter(kind.places(shop.machine)))
        shape = kind.draw(np.random.default_rng(0), shop.machine, place)
        return oracle.apart(shop, (chosen_of(hidden, place, shape, 0.1 * kind.typical(shop.machine, place)),), 0, measure)

    if by == "strengths alone":
        monkeypatch.setattr(oracle, "REFITTED", 0)
    coarse = found()
    monkeypatch.setattr(oracle, "COARSE", 1)
    monkeypatch.setattr(workshop, "COARSE", 1)
    fine = found()
    assert coarse["distances"] == pytest.approx(fine["distances"], rel=0.03, abs=0.2)
    assert min(fine["distances"].values()) < 0.98 * fine["detectability"]


def test_a_load_the_other_way_is_refitted_the_other_way(machines: dict[str, Machine], chosen_of: Callable[..., object]) -> None:
    from concealed.truth.apart import Beside, _most_alike

    shop, measure = a_shop(machines, "slider")
    load = chosen_of("constant_load", "carriage", {}, 1.0)
    typical = load.hidden.kind.typical(shop.machine, "carriage")
    beside = Beside.of(shop, (), (replace(load, strength=-0.3 * typical),), measure)
    like = _most_alike(beside, load.hidden, [])
    assert not like.turned
    assert like.chosen.strength == pytest.approx(-0.3 * typical, rel=0.1)
    assert np.linalg.norm(beside.effect - like.signal) < 0.1 * np.linalg.norm(beside.effect)


def test_numbers_are_refitted_by_simulations_and_not_by_derivatives_alone(
    machines: dict[str, Machine], chosen_of: Callable[..., object]
) -> None:
    """A spring a tenth softer is a number of the machine file, far as it is from its derivative."""
    from concealed.truth.apart import apart
    from concealed.truth.oracle import left_over

    shop, measure = a_shop(machines, "tilted_arm", noise=1e-4)
    softer = chosen_of("joint_compliance", "arm", {}, 0.1)
    effect = measure(shop.matrix(shop.setup((softer,)), shop.training) - shop.matrix(shop.setup(()), shop.training))
    assert left_over(effect, list(measure.numbers.values())) > 20.0
    assert apart(shop, (softer,), 0, measure)["detectability"] < 5.0


def test_numbers_are_refitted_no_further_than_a_machine_file_may_be_off(
    machines: dict[str, Machine], chosen_of: Callable[..., object]
) -> None:
    from concealed.truth.apart import apart

    shop, measure = a_shop(machines, "tilted_arm")
    assert apart(shop, (chosen_of("joint_compliance", "arm", {}, 0.3),), 0, measure)["detectability"] > 1000.0  # 8 without bounds


def family(at: list[float] | np.ndarray) -> np.ndarray:
    """Sines of another frequency and amplitude: the nearest one lies a third of a turn off at the end."""
    t = np.linspace(0.0, 10.0, 400)
    return (1.0 + at[1]) * np.sin(2.0 * np.pi * (1.0 + at[0]) * t)


@pytest.mark.parametrize(("most", "reached"), [(0.2, True), (0.015, False)])
def test_the_nearest_of_a_family_is_found_within_its_bounds(most: float, reached: bool) -> None:
    from concealed.truth.refitted import nearest

    wanted, small = family([0.03, 0.3]), 1e-6
    columns = [(family(change) - family([0.0, 0.0])) / small for change in ([small, 0.0], [0.0, small])]
    bounds = np.array([-most, -0.5]), np.array([most, 0.5])
    visited = []

    def leaves(at: np.ndarray) -> np.ndarray:
        visited.append(at)
        return wanted - family(at)

    found = nearest(leaves, wanted - family([0.0, 0.0]), columns, bounds, np.array([0.02, 0.2]), 1e-3)
    assert bool(found < 0.05 * np.linalg.norm(wanted)) is reached
    assert np.abs(visited).max(axis=0)[0] <= most + 1e-9


def test_derivatives_are_taken_anew_within_the_bounds() -> None:
    from concealed.truth.refitted import nearest

    visited = []

    def leaves(at: np.ndarray) -> np.ndarray:
        visited.append(at)
        return np.array([3.0 - 2.0 * at[0] + at[0] ** 2, 4.0 + (at[1] + 1.5) ** 2])

    columns = [np.array([20.0, 0.0]), np.array([0.0, -3.0])]  # wrong: they are to be taken anew, where the second is at its bound
    nearest(leaves, leaves(np.zeros(2)), columns, (np.array([-1.0, -1.0]), np.array([2.0, 2.0])), np.array([0.2, 0.2]), 0.01)
    assert np.min(visited) >= -1.0
    assert np.any(np.array(visited)[:, 1] == -1.0)

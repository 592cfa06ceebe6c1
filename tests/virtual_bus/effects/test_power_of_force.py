"""Which units scale with all efforts and inertias of a machine."""

from __future__ import annotations

import pytest

from virtual_bus.effects.effect import power_of_force


@pytest.mark.parametrize(
    ("unit", "power"),
    [
        ("Nm", 1),
        ("N s/m", 1),
        ("Nm/A", 1),
        ("kg m^2", 1),
        ("rad/Nm", -1),
        ("K/W", -1),
        ("rad/s", 0),
        ("A", 0),
        ("", 0),
        ("Hz", 0),
        ("A s/rad", 0),
    ],
)
def test_a_unit_has_the_force_that_its_name_has(unit: str, power: float) -> None:
    assert power_of_force(unit) == power

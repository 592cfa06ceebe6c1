"""Delay: a drive that acts on its target later than the machine file says."""

from __future__ import annotations

from virtual_bus.effects.effect import DELAY, Effect, Parameter
from virtual_bus.effects.law import Law, Place, one

EFFECT = Effect(
    name="delay",
    plain="The drive acts later on what it is told than it should.",
    kind=DELAY,
    parameters=(
        Parameter(
            "Td",
            unit="s",
            low=0.0,
            high=0.05,
            description="delay beyond the SYNC at which the target is applied, up to sixteen samples",
        ),
    ),
    equation="u(t - Td)",
    convention=(
        "the target applied at SYNC k acts from Td later on; whole and broken samples; the measured current is that of the target on which "
        "the drive acts at the SYNC: a delay of a whole and a broken part of samples is over only after it"
    ),
    neighbours=("clock_offset", "drive_bandwidth", "structural_mode"),
    source="Åström and Wittenmark 1997, Sec. 3.2",
    family="drive_lag",
    is_exact=True,
)


def delay_s(Td: float) -> float:
    """Return how much later the drive acts [s]."""
    return Td


def laws(place: Place) -> list[Law]:
    """Return a tenth of a row."""
    return [one("Td", min(0.1 * place.period_s, 0.05))]

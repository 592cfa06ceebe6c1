"""Clock offset: a channel that is stamped late, and later as time goes on."""

from __future__ import annotations

from virtual_bus.effects.effect import CLOCK, Effect, Parameter
from virtual_bus.effects.law import Law, Place, each

EFFECT = Effect(
    name="clock_offset",
    plain="Readings are stamped later than they were taken, and ever later where two clocks run apart.",
    kind=CLOCK,
    parameters=(
        Parameter("t0", unit="s", low=0.0, high=0.1, description="age of the channel's values at the start"),
        Parameter("delta", unit="", low=0.0, high=0.01, description="growth of the age per second"),
    ),
    equation="y(t - t0 - delta t)",
    convention=(
        "the reading at SYNC k is the channel's noise-free value t0 + delta t_k earlier, a cubic through four samples between them; before "
        "the start it stood still; an age beyond 63 samples stays there. At an axis, all its encoders and its speed sensor are so old, not "
        "its current, and what a channel has besides is added"
    ),
    neighbours=("delay", "imu_bandwidth"),
    source="IEEE Std 1588, offset and skew",
    family="timing",
    is_exact=True,
    sought_at=("channel",),
    left_out="the age at the start is taken: it grows",
    left_out_of=("delta",),
)


def lag_s(time_s: float, t0: float, delta: float) -> float:
    """Return how old the channel's value is [s]."""
    return t0 + delta * time_s


def laws(place: Place) -> list[Law]:
    """Return a tenth of a row: constant, growing to it until the recording's end, and both."""
    late, growing = min(0.1 * place.period_s, 0.1), min(0.1 * place.period_s / place.duration_s, 0.01)
    return [each(("t0",), late, delta=0.0), each(("delta",), growing, t0=0.0), each(("t0", "delta"), (late, growing))]

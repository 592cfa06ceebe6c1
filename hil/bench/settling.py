"""Standstill before a recording: the axes are held until they stand at their pose, or are told not to."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from controllers.edge_units import at_the_edge
from controllers.settings import AxisLimits
from drivers.machine_link import CanMachine
from hil.bench.loop import SampleLoop
from hil.experiments import Plan

SETTLE_S = 4
"""Whole seconds of standstill before row 0, in which vibrations of the preceding motion decay."""

SETTLE_AT_MOST_S = 16
"""Longest settling [s]: it continues while the integrators still bring the machine closer, on the C-arm with a time constant of 1.6 s. An
axis that hunts about its stiction never stands still."""

STANDING_COUNTS = 2.0
"""Encoder counts from its pose within which an axis counts as standing there."""


def settle(loop: SampleLoop, link: CanMachine, limits: Sequence[AxisLimits], stay: Plan) -> tuple[dict[str, list[float]], tuple[str, ...]]:
    """Hold still until every axis stands at its pose, or `SETTLE_AT_MOST_S` have passed.

    Parameters
    ----------
    loop : SampleLoop
    link : CanMachine
        Of the loop; its drives hold and its brakes are open.
    limits : sequence of AxisLimits
    stay : Plan
        One second of standstill at the pose.

    Returns
    -------
    dict
        In axis order, `deviation` from the pose at the end [rad or m] and mean `speed` over the last second [rad/s or m/s].
    tuple of str
        A line for every axis that does not stand still.
    """
    near = np.array([STANDING_COUNTS * scaling.position_resolution for scaling in link.scalings])
    deviation = speed = link.sample.position - stay.start_pose
    for second in range(SETTLE_AT_MOST_S):
        if second >= SETTLE_S and (np.abs(deviation) <= near).all():
            break
        loop.run(stay)
        before, deviation = deviation, link.sample.position - stay.start_pose
        speed = deviation - before  # over one second
    notes = tuple(
        f"{limit.axis}: does not stand: {at_the_edge(off, limit.unit, 2)} from its pose and moving by "
        f"{at_the_edge(drift, f'{limit.unit}/s', 2)} after {SETTLE_AT_MOST_S} s of standstill, "
        f"{at_the_edge(most, limit.unit, 2)} is standing; recorded all the same (initial.standing)"
        for limit, off, drift, most in zip(limits, deviation, speed, near, strict=True)
        if not abs(off) <= most
    )
    return {"deviation": deviation.tolist(), "speed": speed.tolist()}, notes

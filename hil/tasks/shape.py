"""Reference shapers designed and judged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hil.identification import FrequencyResponse
from hil.machine import Machine
from hil.shaping.aim import periodic, sweep
from hil.shaping.choice import ShaperChoice, choose_shaper
from hil.tasks.errors import as_bench_errors


@as_bench_errors()
def shape(
    machine: Machine,
    axis: str,
    *,
    pose: Mapping[str, float] | None = None,
    frf: FrequencyResponse | None = None,
    period_s: float | None = None,
    harmonics: Sequence[int] = (1, 3, 5),
    longest_s: float | None = None,
    schedule: str = "",
    output: str = "link",
    also: Sequence[str] = (),
) -> ShaperChoice:
    """Design reference shapers for one axis, judge them, and choose the recommended one.

    Parameters
    ----------
    machine : Machine
    axis : str
    pose : mapping, optional
        Positions by axis name [rad or m] at which the machine file's closed loop is taken; axes left out stand at zero.
    frf : FrequencyResponse, optional
        Design from this identified response instead.
    period_s : float, optional
        Period of a scan that repeats; for a sweep none.
    harmonics : sequence of int
        Of the period: tracked without error.
    longest_s : float, optional
        Longest transient; 0.6 s for a sweep and one period otherwise, unless given.
    schedule : str
        Design over the whole range of this axis, and interpolate.
    output : "link", "detector" or "motor"
        What shall track.
    also : sequence of str
        Designs beside the usual ones: "shortest", the shortest delay; "dc", "zpetc", "zmetc", zeros of the path inverted.

    Returns
    -------
    ShaperChoice
        For `machine.run(..., shaper=...)`; `.frame()` has the verdicts of all designs, `.control` the chosen one as a
        `control.TransferFunction`, and `.named("ZVD")` chooses another.

    Raises
    ------
    UnusableInputError, DesignError
    """
    aim = periodic(period_s, harmonics, longest_s) if period_s is not None else sweep() if longest_s is None else sweep(longest_s)
    return choose_shaper(machine, axis, pose=pose, frf=frf, aim=aim, schedule=schedule, output=output, also=also)

"""What changed, in sentences."""

from __future__ import annotations

import math

import numpy as np

from hil.fleet.change.night_by_night import Change, FleetChange

COMMON_SAID = 5.0
"""Deviations of the fleet's median from which its own move is said: above what a machine's alarm needs it is nobody's chance."""


def sentence(change: Change, others: int) -> str:
    """Return a change in a sentence.

    Parameters
    ----------
    change : Change
    others : int
        Machines on which the same parameter did not change.
    """
    parameter, unit = change.parameter, f" {change.parameter.unit}" if change.parameter.unit else ""
    rose = change.sigma > 0.0
    verb = {"step": "jumped up" if rose else "dropped", "growth": "rose" if rose else "fell"}[change.kind]
    before, now = rounded(change.before, change.deviation), rounded(change.now, change.deviation)
    when = f"since {day(change.since)}" if change.kind == "growth" else f"on {day(change.since)}"
    also = f"; so did {', '.join(other.quantity for other in change.also)}" if change.also else ""
    rest = f"; the other {others} machines did not" if others > 1 else "; the other machine did not" if others else ""
    return f"{change.machine}: {parameter.quantity} {verb} from {before} to {now}{unit} {when}, {abs(change.sigma):.1f} sigma{also}{rest}"


def fleet_sentence(found: FleetChange) -> str:
    """Return who needs a visit, in a sentence."""
    machines = len(found.tracks.machines)
    if found.model is None:
        return f"too few nights to say: {len(found.tracks.nights)}"
    who = sorted({change.machine for change in found.changes})
    if not who:
        return f"none of {machines} machines changed" if machines != 1 else "the machine did not change"
    named = ", ".join(who[:5]) + (f" and {len(who) - 5} more" if len(who) > 5 else "")
    return f"{len(who)} of {machines} machines need{'s' if len(who) == 1 else ''} a visit: {named}"


def sentences(found: FleetChange) -> list[str]:
    """Return one sentence a change."""
    machines = len(found.tracks.machines)
    return [sentence(change, machines - sum(other.parameter == change.parameter for other in found.changes)) for change in found.changes]


def common_sentences(found: FleetChange) -> list[str]:
    """Return what moved on all machines at once."""
    if found.model is None:
        return []
    said = []
    count = max(len(found.tracks.machines), 1)
    for j, parameter in enumerate(found.tracks.parameters):
        track = found.common[:, j]
        place = int(np.abs(track).argmax()) if len(track) else 0
        deviation = found.model.scale[j] * math.sqrt(math.pi / 2.0 / count)
        if found.watched[j] and abs(track[place]) > COMMON_SAID * deviation:
            unit = f" {parameter.unit}" if parameter.unit else ""
            most = rounded(track[place], deviation, signed=True)
            now = rounded(track[-1], deviation, signed=True)
            said.append(
                f"all machines: {parameter.quantity} was {most}{unit} on {day(found.tracks.nights[place])} against the first nights,"
                f" {now}{unit} now; no machine's own"
            )
    return said


def day(night: np.datetime64) -> str:
    """Return a night as a date."""
    return str(np.datetime_as_string(night, unit="D"))


def rounded(value: float, deviation: float, signed: bool = False) -> str:
    """Return a number with the digits that its deviation leaves: a tenth of it at most is lost."""
    if not math.isfinite(value):
        return "unknown"
    places = min(max(-math.floor(math.log10(deviation)), 0), 9) if deviation > 0.0 and math.isfinite(deviation) else 3
    return f"{value:{'+' if signed else ''}.{places}f}"

"""Designs of shapers in words: a table within 100 columns."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

from hil.shaping.in_time import WIDTH
from hil.shaping.shaper_design import Candidates, Design
from virtual_bus.linear.left_out import LeftOut, sentences


def design_lines(candidates: Candidates, chosen: Design) -> list[str]:
    """Return a table of all designs, the recommended one first and marked, objections below their row, and designs that failed."""
    head = (
        f"  {'design':14s}{'vibration':>10s}{'at ±10 %':>10s}{'tracking':>10s}{'at ±10 %':>10s}{'transient':>11s}{'largest':>9s}{'sum':>7s}"
    )
    lines = [
        head + f"{'ramp lag':>10s}",
        f"  {'':14s}{'left':>10s}{'':10s}{'error':>10s}{'':10s}{'[s]':>11s}{'gain':>9s}{'':7s}{'[ms]':>10s}",
    ]
    for number, design in enumerate(candidates.designs):
        verdict = design.verdict
        cells = "".join(f"{_percent(share):>10s}" for share in _shares(design))
        row = f"{'*' if design is chosen else ' '} {design.name:14s}{cells}{verdict.transient_s:11.3f}{verdict.largest_gain:9.3g}"
        lines.append(row + f"{verdict.gain_sum:7.2f}{1e3 * verdict.lag_s:10.1f}")
        marks = [text for text in ("recommended" if number == 0 else "", "written" if design is chosen else "") if text]
        if verdict.against:
            marks.append(f"against it: {verdict.against}")
        if marks:
            lines += _wrapped("; ".join(marks), "    ")
        if verdict.residual is not None:
            found = verdict.residual
            low, likely, high = (_percent(share) for share in (found.low, found.likely, found.high))
            of = f"of {found.rms:.2g} {found.unit} rms without a shaper"
            lines += _wrapped(f"left of {found.moves} drawn moves as simulated: {low} to {high}, median {likely}, {of}", "    ")
    for name, reason in candidates.refused.items():
        lines += _wrapped(f"{name}: none: {reason}", "  ")
    if candidates.not_simulated:
        lines += _wrapped(f"no moves are simulated, the figures are those of the linear loop alone: {candidates.not_simulated}", "")
    return lines


def left_out_lines(design: Design) -> list[str]:
    """Return the poles that a design leaves alone, with what is left of a unit step in them."""
    listed = design.verdict.left_out
    if not listed:
        return [f"{design.name}: every pole that matters is cancelled"]
    shares = ", ".join(f"{each.frequency_Hz:.3g} Hz (damping {each.damping:.2g}) {each.residual:.2g}" for each in listed)
    return _wrapped(f"{design.name}: poles left out, with what is left of a unit step in them after the transient: {shares}", "")


def outside_lines(outside: Sequence[LeftOut]) -> list[str]:
    """Return the effects of the machine file that figures of the linear loop do not hold; those as simulated do."""
    said = [f"vibration, tracking error and ramp lag, of the linear loop, are without {each}" for each in sentences(outside)]
    return [line for each in said for line in _wrapped(each, "")]


def _wrapped(text: str, indent: str) -> list[str]:
    return textwrap.wrap(text, WIDTH, initial_indent=indent, subsequent_indent=indent + "  ", break_long_words=False)


def _shares(design: Design) -> tuple[float, float, float, float]:
    verdict = design.verdict
    return verdict.vibration, verdict.vibration_at_10, verdict.tracking, verdict.tracking_at_10


def _percent(share: float) -> str:
    return "0 %" if share < 5e-10 else f"{100.0 * share:.3g} %"

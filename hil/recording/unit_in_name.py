"""Units in the names of signals: `Speed (rpm)`, `Position / deg`, `position_deg`, `velRadPerS`, `Iq_mA`."""

from __future__ import annotations

import re
from collections.abc import Container, Iterator

from hil.recording.channels import spelled

_IN_BRACKETS = re.compile(r"(.*[^\s(<{])\s*(?:\(([^()]+)\)|<([^<>]+)>|\{([^{}]+)\})")
_BETWEEN = re.compile(r"[\s_.,/-]+")
_CAMEL = re.compile(r"(?<=[a-z0-9])(?=[A-Z])")
_PER = re.compile(r"(.+)(?:Per|PER|ps)(.*)")
_RATE_OF = ("s", "sec", "s2", "min")
"""What a rate is per, where a name lacks the sign of division: `vel_deg_s`."""

_WORDS = frozenset({"turn", "rot", "rotation", "revolution", "in", "r"})
"""Spellings of units that say something else in a name: `q_rot`, `i_in`."""

_OF_ONE_LETTER = frozenset({"%", "°", "‰", "g", "C", "s"})
"""Units of one letter that a name can end in; the others are SI's own, which change nothing, or another thing, as in `phase_A`."""


def in_brackets(name: str) -> tuple[str, str] | None:
    """Return what stands before brackets at a name's end, and in them; None where there are none."""
    match = _IN_BRACKETS.fullmatch(name.strip())
    return None if match is None else (match[1].strip(), next(text for text in match.groups()[1:] if text is not None).strip())


def unit_in_name(name: str, known: Container[str]) -> tuple[str, str] | None:
    """Return a name without its unit, and that unit as it is written here; None where none of the known ones is in it."""
    bracketed = in_brackets(name)
    for rest, text in [bracketed] if bracketed else _endings(name.strip()):
        if text.lower() in _WORDS or (len(text) == 1 and text not in _OF_ONE_LETTER and not (bracketed and text in known)):
            continue
        unit = spelled(text, known)
        if unit in known:
            return rest, unit
    return None


def _endings(name: str) -> Iterator[tuple[str, str]]:
    """Yield what a name may be without its unit, and the unit, the longest first."""
    gaps = list(_BETWEEN.finditer(name))
    ends = [name[gap.end() :] for gap in gaps]
    words = _BETWEEN.split(name)
    last = words[-1]
    if len(gaps) > 1 and words[-2].lower() == "per":  # rad_per_s
        yield name[: gaps[-3].start()] if len(gaps) > 2 else "", f"{words[-3]}/{last}"
    if gaps and last.lower() in _RATE_OF:  # deg_s
        yield name[: gaps[-2].start()] if len(gaps) > 1 else "", f"{words[-2]}/{last}"
    for gap, end in list(zip(gaps, ends, strict=True))[::-1][:2]:  # deg, deg/s
        yield name[: gap.start()], end
    for edge in [0, *(match.start() for match in _CAMEL.finditer(last))]:  # RadPerS, Deg, degps
        rest = name[: len(name) - len(last) + edge].rstrip("_ .,/-")
        if match := _PER.fullmatch(last[edge:]):
            yield rest, f"{match[1]}/{match[2] or 's'}"
        yield rest, last[edge:]

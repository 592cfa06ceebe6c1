"""Channels of recordings as curves to be laid over each other, aligned, with channels that are derived from them."""

from __future__ import annotations

import base64
import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hil.errors import UnusableInputError, in_one_line
from hil.machine import load_machine
from hil.recording import Recording, read_recording
from hil.reports.derived import derived_from, in_time, shift_to, spectrum

KEPT = 8
"""Recordings that are kept in memory, each as long as its file is not written anew."""
MOST_ROWS = 60_000
"""Rows of a curve that are sent: a screen has some thousand columns. Of a longer one every so many rows the least and the greatest."""


def curves(machine: str, files: Sequence[str], channels: Sequence[str], align: str) -> dict[str, Any]:
    """Read curves.

    Parameters
    ----------
    machine : str
        As the command line takes it, for recordings that do not name theirs.
    files : sequence of str
        Recordings.
    channels : sequence of str
        Names, or `A - B`, `d(A)`, `spectrum(A)`; one that a recording has not is left out there.
    align : str
        Channel by which the recordings are shifted over the first; "" begins each with its first row.

    Returns
    -------
    dict
        `channels`, each name with its unit; `shifts_s` of the recordings, in their order; and `curves`, each with `of`, the index of its
        recording, `channel`, and `error`, one line, or `unit`, `kind`, and `x` [s or Hz] and `y` as base64 of float64; or `error`, one
        line, where the recordings cannot be read or aligned.
    """
    try:
        recordings = [_read(machine, name, Path(name).stat().st_mtime_ns) for name in files]
        shifts_s = [-float(each.time[0]) if each.rows else 0.0 for each in recordings]
        if align:
            shifts_s = [shifts_s[0], *(shifts_s[0] + shift_to(recordings[0], other, align) for other in recordings[1:])]
        there = {name: channel.unit for each in recordings for name, channel in each.channels.items() if name != "time"}
        found = [
            {"of": number} | curve
            for text in channels
            for number, (recording, shift_s) in enumerate(zip(recordings, shifts_s, strict=True))
            for curve in _curve(text, recording, shift_s)
        ]
    except (UnusableInputError, OSError, ValueError) as error:
        return {"error": in_one_line(error)[0]}
    return {"channels": list(there.items()), "shifts_s": shifts_s, "curves": found}


@functools.lru_cache(KEPT)
def _read(machine: str, name: str, written_ns: int) -> Recording:
    return read_recording(Path(name), load_machine(machine))


def _curve(text: str, recording: Recording, shift_s: float) -> list[dict[str, Any]]:
    """Return the curve of a channel in a list, or why it cannot be derived; none where the recording has it not."""
    try:
        return _found(text, recording, shift_s)
    except (UnusableInputError, ValueError) as error:
        return [{"channel": text, "error": in_one_line(error)[0]}]


def _found(text: str, recording: Recording, shift_s: float) -> list[dict[str, Any]]:
    kind, x = "time", recording.time + shift_s
    if text in recording:
        channel = recording.channels[text]
    else:
        derived = derived_from(text) if not text.isidentifier() else None
        if derived is None or any(name not in recording for name in derived.of):
            return []
        kind = derived.kind
        if kind == "spectrum":
            x, channel = spectrum(derived, recording)
        else:
            channel = in_time(derived, recording)
    x, y = _thinned(x, channel.values)
    return [{"channel": text, "unit": channel.unit, "kind": kind, "x": _packed(x), "y": _packed(y)}]


def _thinned(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return of long columns (N,) the least and the greatest of every so many rows, in their order."""
    if y.size <= MOST_ROWS:
        return x, y
    each = -(-2 * y.size // MOST_ROWS)
    blocks = np.pad(np.where(np.isfinite(y), y, np.nan), (0, -y.size % each), constant_values=np.nan).reshape(-1, each)
    low, high = (np.where(np.isnan(blocks), worst, blocks) for worst in (np.inf, -np.inf))
    first = np.arange(len(blocks)) * each
    rows = np.sort(np.column_stack((first + low.argmin(axis=1), first + high.argmax(axis=1))), axis=1).ravel()
    return x[rows], y[rows]


def _packed(values: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f8").tobytes()).decode()

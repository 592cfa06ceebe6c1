"""Where a plate stands, from windows about its expected grooves: one shift and one turn for all grooves of a direction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from hil.imaging.markers.pieces import BIN, profiles, split

WIDEST_TURN = np.tan(np.radians(6.0))
"""A plate may be turned this far from where it is expected."""

PIECE = 3.0
"""Pieces of the windows are this many grooves' widths long."""

STRIDE = 4
"""Every so many places along a groove are looked at."""

MOST = 4.0
"""A piece's evidence is held below this many standard deviations: a wire or a table's edge is darker or brighter than any groove."""


@dataclass(frozen=True)
class Window:
    """A groove as expected: number, across = offset + slope * along, and which places along it to use."""

    number: int
    offset: float
    slope: float
    keep: np.ndarray


def look(image: np.ndarray, windows: list[Window], width: float, gate: float) -> dict[int, tuple[float, float]]:
    """Return offset and slope of each groove by the shift and the turn that most pieces of all windows speak for.

    Parameters
    ----------
    image : (along, across) array
        As `profiles` takes it.
    windows : list of Window
        Of one direction, without those that have no place along them.
    width : float
        Of the grooves [pixel].
    gate : float
        Largest common shift [pixel].
    """
    length = len(windows[0].keep)
    half, middle = 0.5 * length, 0.5 * (length - 1)
    widest = WIDEST_TURN * half
    reach = gate + widest + 1.5 * width
    box = max(1, round(0.5 * width / BIN))
    evidence, place = [], []
    for window in windows:
        seen = profiles(image, window.offset, window.slope, split(window.keep, PIECE * width), reach, stride=STRIDE)
        evidence.append(_evidence(seen.counts, seen.number, box))
        place.append((seen.along - middle) / half)
    center = round(reach / BIN)
    shifts = np.arange(-round(gate / BIN), round(gate / BIN) + 1)
    turns = np.arange(-round(widest / width * 2.0), round(widest / width * 2.0) + 1) * 0.5 * width / BIN
    score = _votes(np.concatenate(evidence), np.concatenate(place), center, shifts, turns)
    turn, shift = np.unravel_index(np.argmax(score), score.shape)
    found = {}
    for window, of_pieces, along in zip(windows, evidence, place, strict=True):
        # each groove again for itself, near where all together put it: a tilted plate or another distance moves it by a little
        near = shifts[shift] + np.arange(-box, box + 1)
        turned = turns[turn] + np.array([-0.5, 0.0, 0.5]) * box
        own = _votes(of_pieces, along, center, near, turned)
        best_turn, best = np.unravel_index(np.argmax(own), own.shape)
        tilt = turned[best_turn] * BIN / half
        found[window.number] = (window.offset + near[best] * BIN - tilt * middle, window.slope + tilt)
    return found


@njit(cache=True)
def _evidence(counts: np.ndarray, number: np.ndarray, box: int) -> np.ndarray:
    """Return, for each piece and bin, how much brighter a groove's width about it is than a width to either side.

    In standard deviations of the photons, within `MOST`.
    """
    pieces, bins = counts.shape
    result = np.zeros((pieces, bins))
    sums, pixels = np.zeros(bins + 1), np.zeros(bins + 1)
    for k in range(pieces):
        for j in range(bins):
            sums[j + 1] = sums[j] + counts[k, j] * number[k, j]
            pixels[j + 1] = pixels[j] + number[k, j]
        for j in range(2 * box, bins - 2 * box):
            inside, of_inside = sums[j + box] - sums[j - box], pixels[j + box] - pixels[j - box]
            before, of_before = sums[j - box] - sums[j - 2 * box], pixels[j - box] - pixels[j - 2 * box]
            after, of_after = sums[j + 2 * box] - sums[j + box], pixels[j + 2 * box] - pixels[j + box]
            if of_inside > 0.0 and of_before > 0.0 and of_after > 0.0:
                bright = inside / of_inside
                # above both sides: at a single edge one side is as bright as the groove would be
                rise = bright - max(before / of_before, after / of_after)
                deviation = np.sqrt(max(bright, 1.0) * (1.0 / of_inside + 1.0 / min(of_before, of_after)))
                result[k, j] = min(max(rise / deviation, -MOST), MOST)
    return result


@njit(cache=True)
def _votes(evidence: np.ndarray, along: np.ndarray, center: int, shifts: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """Return the sum of evidence for every turn and shift (turns, shifts); `turns` are shifts at along = 1."""
    result = np.zeros((len(turns), len(shifts)))
    bins = evidence.shape[1]
    for t in range(len(turns)):
        for s in range(len(shifts)):
            total = 0.0
            for k in range(len(along)):
                j = center + shifts[s] + int(np.rint(turns[t] * along[k]))
                if 0 <= j < bins:
                    total += evidence[k, j]
            result[t, s] = total
    return result

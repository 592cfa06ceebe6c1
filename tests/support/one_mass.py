"""One mass on a damper in a digital loop, by its exact recursion: written from docs/explanation/notation.md alone."""

from __future__ import annotations

import numpy as np
import scipy.linalg
import scipy.signal


def rounded(value: float, resolution: float) -> float:
    return np.floor(value / resolution + 0.5) * resolution if resolution else value


def closed_loop(
    reference: np.ndarray,
    excitation: np.ndarray,
    *,
    mass: float,
    damping: float,
    gain: float,
    period_s: float,
    position_sections: np.ndarray,
    reference_sections: np.ndarray,
    limit: float,
    count: float,
    target_step: float,
    start: float,
) -> np.ndarray:
    """Rows of (position, command): position k is latched before command k acts; the plant feels command k-1 between rows k and k+1."""
    transition = scipy.linalg.expm(np.array([[0.0, 1.0, 0.0], [0.0, -damping / mass, gain / mass], [0.0, 0.0, 0.0]]) * period_s)
    state = np.array([start, 0.0])
    filters = {name: scipy.signal.sosfilt_zi(s) * start for name, s in (("r", reference_sections), ("y", position_sections))}
    command = 0.0
    rows = []
    for r, w in zip(reference, excitation, strict=True):
        effort = rounded(command, target_step)
        position = rounded(state[0], count)
        from_r, filters["r"] = scipy.signal.sosfilt(reference_sections, [r], zi=filters["r"])
        from_y, filters["y"] = scipy.signal.sosfilt(position_sections, [position], zi=filters["y"])
        command = float(np.clip(from_r[0] - from_y[0] + w, -limit, limit))
        rows.append((position, command))
        state = transition[:2, :2] @ state + transition[:2, 2] * effort
    return np.array(rows)

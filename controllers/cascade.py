"""A drive's own position and velocity loops, and the law in effort that they are, together with what the bench adds around them.

A drive in cyclic synchronous position or velocity mode closes loops of its own. They are linear and run on the positions that the bench
sees, so bench and drive together are one law u = C_r r - C_y y + w + feedforward in the drive's effort. With q = 1/z and sample period T

    velocity loop   K_v = F (k_p + k_i T q / (1 - q)),  on demanded less measured speed, F the drive's filter of the torque
    measured speed  D = s / T (1 - q) / (1 - (1 - s) q),  differences of the position through a first-order filter of share s
    position loop   demanded speed = k_x (target - y)

    velocity mode   C_r = K_v R,              C_y = K_v (Y + D)
    position mode   C_r = K_v k_x (1 + R),    C_y = K_v (k_x (1 + Y) + D)

with the bench's own filters R and Y (`AxisCommand`). Margins, simulation and diagnosis use this law, the bench's loop R and Y alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Literal

import numpy as np

from controllers.errors import DesignError
from controllers.settings import AxisController

CommandMode = Literal["velocity", "position"]
"""What the bench commands of a drive that closes loops of its own: cyclic synchronous velocity or position mode of CiA 402."""

NO_SECTIONS = np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0]])
"""A filter that gives zero."""


@dataclass(frozen=True)
class DriveLoops:
    """Gains of a drive's own loops, at the joint."""

    position_gain: float  # k_x [1/s]
    velocity_gain: float  # k_p, drive's unit per rad/s or m/s
    velocity_integral_gain: float  # k_i, drive's unit per rad or m
    speed_filter: float  # s, share of the newest difference in the measured speed; 1: no filter
    torque_sections: np.ndarray | None = None  # F, (n, 6) at the sample rate, with a static gain of 1; None: no filter


@dataclass(frozen=True)
class AxisCommand:
    """What the bench commands of an axis whose drive closes loops of its own: R r - Y y, in position mode beside the reference itself.

    Excitation and feedforward are efforts and go into the drive's torque offset.
    """

    mode: CommandMode
    controller: AxisController  # Y and R, from rad or m to the unit of the command; its limit is theirs, not the reference's
    loops: DriveLoops


def in_effort(command: AxisCommand, limit: float, sample_rate_Hz: float) -> AxisController:
    """Return the law in effort of a command and the drive's loops behind it.

    Parameters
    ----------
    command : AxisCommand
    limit : float
        Largest effort, drive's unit.
    sample_rate_Hz : float

    Raises
    ------
    DesignError
        The bench's own filters integrate: the drive's velocity loop already does.
    """
    from controllers.sections import integrates  # compiled code and SciPy's signals, which only drives with loops of their own need

    loops, own = command.loops, command.controller
    y = own.position_sections
    r = y if own.reference_sections is None else own.reference_sections
    if integrates(y).any() or integrates(r).any():
        raise DesignError(
            f"{own.axis}: its controller integrates, and so does the drive's velocity loop; in {command.mode} mode leave the integrator out"
        )
    period_s = 1.0 / sample_rate_Hz
    share = loops.speed_filter
    speed = np.array([[share / period_s, -share / period_s, 0.0, 1.0, share - 1.0, 0.0]])
    velocity_loop = np.array([[loops.velocity_gain, loops.velocity_integral_gain * period_s - loops.velocity_gain, 0.0, 1.0, -1.0, 0.0]])
    if loops.torque_sections is not None:
        velocity_loop = np.vstack([velocity_loop, loops.torque_sections])
    if command.mode == "position":
        k = loops.position_gain
        from_reference, from_position = _sum([_scaled(k, None), _scaled(k, r)]), _sum([_scaled(k, None), _scaled(k, y), speed])
    else:
        from_reference, from_position = r, _sum([y, speed])
    return AxisController(
        own.axis,
        np.vstack([from_position, velocity_loop]),
        np.vstack([from_reference, velocity_loop]),
        limit,
        own.gravity_feedforward,
    )


def _scaled(gain: float, sections: np.ndarray | None) -> np.ndarray:
    """Return a cascade times a gain; None is 1."""
    scaled = np.array([[1.0, 0.0, 0.0, 1.0, 0.0, 0.0]]) if sections is None else sections.copy()
    scaled[0, :3] *= gain
    return scaled


def _sum(cascades: Sequence[np.ndarray]) -> np.ndarray:
    """Return the sum of cascades as one cascade: the poles are theirs, the zeros the roots of the summed numerators.

    Polynomials are in q, lowest power first, which is in z, highest power first.
    """
    from scipy.signal import zpk2sos

    numerator, poles = np.zeros(1), np.zeros(0)
    fractions = [(_product(cascade[:, :3]), _product(cascade[:, 3:]), cascade) for cascade in cascades if cascade[:, :3].any(axis=1).all()]
    if len(fractions) == 1:
        return fractions[0][2]
    for i, (own, _, cascade) in enumerate(fractions):
        others = [denominator for j, (_, denominator, _) in enumerate(fractions) if j != i]
        term = _product([own, *others])
        numerator = np.pad(numerator, (0, max(0, len(term) - len(numerator)))) + np.pad(term, (0, max(0, len(numerator) - len(term))))
        poles = np.concatenate([poles, *(np.roots(section) for section in cascade[:, 3:])])
    zeros = np.roots(numerator)
    at_origin = min(int(np.count_nonzero(zeros == 0.0)), int(np.count_nonzero(poles == 0.0)))
    sections: np.ndarray = zpk2sos(_without_origin(zeros, at_origin), _without_origin(poles, at_origin), numerator[0])
    return sections


def _product(polynomials: Iterable[np.ndarray]) -> np.ndarray:
    return reduce(np.convolve, polynomials, np.ones(1))


def _without_origin(roots: np.ndarray, count: int) -> np.ndarray:
    """Leave out this many roots at the origin."""
    return np.concatenate([roots[roots != 0.0], np.zeros(np.count_nonzero(roots == 0.0) - count)])

"""Harmonic time-delay filters for a plant that is typed: a transfer function, or its zeros and poles, as in the examples of Chapter 7.

Continuous, without a machine file: delays are what the conditions ask for, and no whole samples.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from controllers.errors import DesignError
from controllers.shapers.delays import DelayFilter
from controllers.shapers.dynamics import Dynamics
from controllers.shapers.harmonic_time_delay import harmonic, harmonic_conditions
from controllers.shapers.shortest_delays import shortest_delays
from controllers.shapers.zero_inversion import tail_of
from hil.errors import UnusableInputError
from hil.shaping.response import shaped_response, sinusoids

OFF = 0.1
"""Share by which forcing frequencies and poles are moved to tell how sensitive a filter is, as in Fig. 7.9."""
LARGEST_GAINS = 100.0
"""Sum of the gains' sizes of a shortest filter: as its delay goes to zero they grow beyond all use."""
PERIODS = 2.0
"""Of the slowest pole: how long a shortest delay is sought unless the user says."""
SHOWN_TRANSIENTS, POINTS = 4.0, 2001
"""How much of the response goes into a table: transients of the filter, and two periods of the slowest frequency at least."""
SAME_POLE = 1e-3
"""Share of its size within which a pole that is typed is one of the plant's: four digits are typed."""


@dataclass(frozen=True, eq=False)
class TypedDesign:
    """A filter for a plant that was typed.

    Attributes
    ----------
    plant : Dynamics
    shaper : DelayFilter
    forcing_rad_s : (m,) array
    through, through_off : (m,) arrays
        |P G - 1| at each forcing frequency; the largest where that frequency is `OFF` higher or lower.
    pole_off : float
        Largest |P G - 1| at the forcing frequencies where all of the plant's poles and zeros are `OFF` faster or slower.
    unshaped : (m,) array
        |P - 1|.
    """

    plant: Dynamics
    shaper: DelayFilter
    forcing_rad_s: np.ndarray
    through: np.ndarray
    through_off: np.ndarray
    pole_off: float
    unshaped: np.ndarray

    def in_time(self, times_s: np.ndarray) -> np.ndarray:
        """Return a reference that sums all forcing sines from t = 0 on, the plant's output without the filter and with it (N, 3)."""
        count = len(self.forcing_rad_s)
        phases = np.where(self.forcing_rad_s == 0.0, 0.5 * np.pi, 0.0)  # of the mean: a step
        reference = sinusoids([1.0] * count, self.forcing_rad_s.tolist(), phases.tolist())
        plain = DelayFilter(np.zeros(1), np.ones(1))
        shown = [shaped_response(self.plant, each, reference, times_s) for each in (plain, self.shaper)]
        return np.column_stack([reference.at(times_s), *shown])


def from_coefficients(numerator: Sequence[float], denominator: Sequence[float]) -> Dynamics:
    """Return the plant with these coefficients, the highest power of s first.

    Raises
    ------
    UnusableInputError
        A polynomial is nothing, or there is no pole.
    DesignError
        There are more zeros than poles.
    """
    if not np.any(numerator) or not np.any(denominator) or len(np.trim_zeros(np.asarray(denominator, dtype=float), "f")) < 2:
        raise UnusableInputError("a plant takes a numerator and a denominator with a power of s, such as 2 and 1,0.0566,2")
    return Dynamics.from_polynomials(numerator, denominator)


def from_roots(zeros: Sequence[complex], poles: Sequence[complex], static_gain: float = 1.0) -> Dynamics:
    """Return the plant with these zeros and poles [rad/s], where a complex one stands for its conjugate, too, and this gain at s = 0.

    Raises
    ------
    UnusableInputError
        There is no pole, a pole or zero at 0, where the gain at s = 0 says nothing, or one that is typed more often than its conjugate.
    DesignError
        There are more zeros than poles.
    """
    if not len(poles) or any(root == 0.0 for root in (*zeros, *poles)):
        raise UnusableInputError("a plant of poles and zeros takes a pole and none of either at 0; type its transfer function instead")
    top, bottom = (np.atleast_1d(np.real(np.poly(_with_conjugates(roots)))) for roots in (zeros, poles))
    return from_coefficients((static_gain * bottom[-1] / top[-1] * top).tolist(), bottom.tolist())


def plant_of(numerator: str, denominator: str, poles: str, zeros: str, static_gain: float) -> Dynamics:
    """Return the plant that was typed in one of both forms.

    Raises
    ------
    UnusableInputError
        Neither form, both, or no numbers.
    """
    by_coefficients = bool(numerator or denominator)
    if by_coefficients == bool(poles or zeros):
        raise UnusableInputError("type the plant once: --numerator and --denominator, or --poles, with --zeros if it has any")
    if by_coefficients:
        top, bottom = (numbers_in(*each, are_real=True) for each in (("--numerator", numerator), ("--denominator", denominator)))
        return from_coefficients([each.real for each in top], [each.real for each in bottom])
    return from_roots(numbers_in("--zeros", zeros), numbers_in("--poles", poles), static_gain)


def numbers_in(option: str, text: str, *, are_real: bool = False) -> list[complex]:
    """Read `1,-0.5+2j`, both i and j for the imaginary unit; nothing is an empty list.

    Raises
    ------
    UnusableInputError
        Not of that form.
    """
    try:
        numbers = [complex(part.replace(" ", "").replace("i", "j")) for part in text.split(",")] if text.strip() else []
    except ValueError:
        numbers = [complex(np.nan)]
    if not np.isfinite(numbers).all() or (are_real and any(each.imag != 0.0 for each in numbers)):
        raise UnusableInputError(
            f"{option} {text}: must be numbers with commas between them, such as {'2,0.5' if are_real else '-0.1+2j,-3'}"
        )
    return numbers


def _with_conjugates(roots: Sequence[complex]) -> np.ndarray:
    """Return roots with the conjugates that they lack: each lacks its own, or none does."""
    found: list[complex] = []
    for root in map(complex, roots):
        mine, others = roots.count(root), roots.count(root.conjugate())
        if others not in (0, mine):
            raise UnusableInputError(
                f"{root:.4g} rad/s stands {mine} times and its conjugate {others} times: type one of each pair, or both of each"
            )
        found += [root] if others else [root, root.conjugate()]
    return np.array(found)


def design_for(
    plant: Dynamics,
    forcing_rad_s: Sequence[float],
    *,
    delay_s: float | None = None,
    longest_s: float | None = None,
    robust_poles: Sequence[complex] = (),
    robust_forcing_rad_s: Sequence[float] = (),
    inverse: str = "",
) -> TypedDesign:
    """Design a filter with which a plant follows these frequencies, and none of its poles rings.

    Parameters
    ----------
    plant : Dynamics
    forcing_rad_s : sequence of float
        0: the reference has a mean.
    delay_s : float, optional
        T, one tap more than conditions need (Sec. 7.2.3); the shortest there is (7.27) unless given.
    longest_s : float, optional
        Of a shortest delay; two periods of the slowest pole unless given.
    robust_poles, robust_forcing_rad_s : sequences
        Poles and forcing frequencies to whose change the filter is insensitive, (7.35), (7.36).
    inverse : "", "dc", "zpetc" or "zmetc"
        Whether the plant's zeros are inverted on the last tap (7.33), and what stands for those that cannot be.

    Raises
    ------
    UnusableInputError
        No forcing frequency, or a robust pole that is none of the plant's.
    DesignError
        The plant is not stable, a frequency lies on a pole, or there is no filter.
    """
    if not len(forcing_rad_s):
        raise UnusableInputError("a filter needs a frequency that it tracks: 0 for a reference with a mean")
    robust = dict.fromkeys(_own(pole, plant) for pole in robust_poles)  # a pair is typed by one or both
    conditions = harmonic_conditions(plant, forcing_rad_s, robust_poles=robust, robust_forcing_rad_s=robust_forcing_rad_s)
    tail, ahead_s = tail_of(plant, inverse) if inverse else (None, 0.0)
    if delay_s is not None:
        shaper = harmonic(conditions, delay_s, tail=tail, ahead_s=ahead_s)
    else:
        longest = PERIODS * 2.0 * np.pi / float(np.abs(plant.poles).min()) if longest_s is None else longest_s
        try:
            (shaper,) = shortest_delays(conditions, longest, tail=tail, gain_sum_limit=LARGEST_GAINS, count=1)
        except DesignError as error:
            raise DesignError(f"{error}; with --delay you choose T yourself, and one tap more meets them") from None
    forcing = np.asarray(forcing_rad_s, dtype=float)
    return TypedDesign(
        plant, shaper, forcing, _missed(plant, shaper, forcing),
        np.max([_missed(plant, shaper, forcing * (1.0 + share)) for share in (-OFF, OFF)], axis=0),
        float(np.max([_missed(_faster(plant, 1.0 + share), shaper, forcing) for share in (-OFF, OFF)])),
        np.abs(plant.response(1j * forcing) - 1.0),
    )  # fmt: skip


def _own(pole: complex, plant: Dynamics) -> complex:
    """Return the plant's pole of the upper half plane that was typed."""
    wanted = complex(pole.real, abs(pole.imag))
    found = complex(plant.poles[np.argmin(np.abs(plant.poles - wanted))])
    if abs(found - wanted) > SAME_POLE * abs(wanted):
        said = ", ".join(f"{each:.4g}" for each in plant.poles if each.imag >= 0.0)
        raise UnusableInputError(f"robust pole {pole:.4g} rad/s: the plant has {said}")
    return found


def _missed(plant: Dynamics, shaper: DelayFilter, forcing_rad_s: np.ndarray) -> np.ndarray:
    missed: np.ndarray = np.abs(plant.response(1j * forcing_rad_s) * shaper.response(1j * forcing_rad_s) - 1.0)
    return missed


def _faster(plant: Dynamics, factor: float) -> Dynamics:
    """Return P(s / factor): poles and zeros so much faster, the gain at s = 0 as it was."""
    return Dynamics(factor * plant.a, factor * plant.b, plant.c, plant.d)


def lines(found: TypedDesign) -> Iterator[str]:
    """Say in words what a design is, and what it does."""
    shaper = found.shaper
    yield f"{len(shaper.gains)} taps over {shaper.transient_s:.4f} s, T = {shaper.delays_s[1]:.4f} s, gains {shaper.gain_sum:.3g} in sum"
    yield (
        "G(s) = "
        + " ".join(
            f"{gain:+.4f}{f' e^(-{delay:.4f} s)' if delay else ''}" for gain, delay in zip(shaper.gains, shaper.delays_s, strict=True)
        )
        + ("" if shaper.tail is None else ", the last tap behind the inverse of the zeros")
    )
    for k, frequency in enumerate(found.forcing_rad_s):
        yield (
            f"at {frequency:g} rad/s: error {found.through[k]:.2g} of the reference, {found.unshaped[k]:.2g} without the filter, "
            f"{found.through_off[k]:.2g} with the frequency {OFF:.0%} off"
        )
    yield f"with all poles and zeros {OFF:.0%} off: error {found.pole_off:.2g} at most"


def document(found: TypedDesign) -> dict[str, Any]:
    """Return the same as plain values."""
    return {
        "poles": [[pole.real, pole.imag] for pole in found.plant.poles.tolist()],
        "delays_s": found.shaper.delays_s,
        "gains": found.shaper.gains,
        "transient_s": found.shaper.settled_s,
        "forcing_rad_s": found.forcing_rad_s,
        "error": found.through,
        "error_unshaped": found.unshaped,
        "error_forcing_off": found.through_off,
        "error_poles_off": found.pole_off,
    }


def write_in_time(found: TypedDesign, path: Path) -> None:
    """Write the response to the sum of the forcing sines as CSV."""
    moving = found.forcing_rad_s[found.forcing_rad_s > 0.0]
    longest = max(SHOWN_TRANSIENTS * found.shaper.transient_s, 4.0 * np.pi / moving.min() if len(moving) else 0.0)
    times = np.linspace(0.0, longest, POINTS)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["time [s]", "reference", "output_unshaped", "output_shaped"])
        writer.writerows(np.column_stack([times, found.in_time(times)]).tolist())

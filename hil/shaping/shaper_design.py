"""Design of all candidate shapers at the sample rate for one axis at one or several poses, judged, the recommended one first."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from controllers.errors import DesignError
from controllers.shapers.conditions import LIGHTLY_DAMPED, Condition, cancelling
from controllers.shapers.delays import DelayFilter
from controllers.shapers.dynamics import Dynamics, Mode
from controllers.shapers.harmonic_time_delay import harmonic, harmonic_conditions, tap_count
from controllers.shapers.point_to_point import ei, multi_mode, two_hump_ei, zv, zvd
from controllers.shapers.quiet import check_band, quiet
from controllers.shapers.sampled import AxisShaper, axis_shaper, on_samples
from controllers.shapers.shortest_delays import shortest_delays
from controllers.shapers.zero_inversion import METHODS, invertible, tail_of
from hil.shaping.aim import Aim
from hil.shaping.verdict import GAIN_LIMIT, Subject, Verdict, judge, vibration_left

FAST = 1.0 / 3.0
"""Modes above this share of the sample rate are fast: half their period is below one and a half samples. They are left out and listed."""

SLOW = 0.125
"""Modes below this share of the sample rate must be there at every pose of a schedule; of those above, as many as every pose has count."""

SEEN = 1e-3
"""A mode belongs to the axis if it contributes at least this share of the ringing acceleration at one of the poses."""

NOTCH_DAMPING = 0.7
"""Damping of the notch's poles: as wide as a notch can be without ringing itself."""

HARMONIC = ("hTDF", "hTDF robust", "hTDF quiet")

SHORTEST = "hTDF shortest"
INVERTED = {method: f"hTDF {method}" for method in METHODS}
ALSO = ("shortest", *METHODS)
"""Designs beside the usual ones: the shortest delay, (7.27)-(7.30), and zeros of the path inverted, (7.33), (7.34)."""

QUIET_BAND_Hz = (4.0, 20.0)
"""Band in which the C-arm's structure rings: 8 Hz and 14 Hz, and the modes that move between them."""


@dataclass(frozen=True)
class Design:
    """A shaper and its verdict."""

    filters: tuple[DelayFilter, ...]  # one per pose
    verdict: Verdict
    cancelled: tuple[tuple[complex, ...], ...]

    @property
    def name(self) -> str:
        """Name of the shaper."""
        return self.verdict.name


@dataclass(frozen=True)
class Candidates:
    """Designs, the recommended one first, and the designs that failed: name and reason; and why no moves were simulated, or ""."""

    designs: tuple[Design, ...]
    refused: dict[str, str]
    not_simulated: str = ""

    def named(self, name: str) -> Design:
        """Return the design of this name.

        Raises
        ------
        DesignError
            There is no such design; the message names the existing ones, or the reason.
        """
        for design in self.designs:
            if design.name == name:
                return design
        raise DesignError(self.refused.get(name) or f"design {name!r}: must be one of {', '.join(each.name for each in self.designs)}")


@dataclass(frozen=True)
class MapRow:
    """One delay of a map as in Fig. 7.12: gains, their sum, the transient and the worst vibration at 10 percent."""

    delay_s: float
    filters: tuple[DelayFilter, ...]
    gain_sum: float
    largest_gain: float
    transient_s: float
    vibration_at_10: float


def subject(tracked: Dynamics, rung: Sequence[Dynamics]) -> Subject:
    """Return the path that shall track, and its lightly damped modes weighted by their effect on `rung` (paths with the same poles)."""
    tracked.check_stable()
    weights: dict[complex, float] = {}
    for path in rung:
        for mode in path.modes:
            if mode.damping < LIGHTLY_DAMPED:
                key = complex(np.round(mode.pole, 6))
                weights[key] = float(np.hypot(weights.get(key, 0.0), mode.step_share))
    modes = sorted((Mode(pole, weight) for pole, weight in weights.items()), key=lambda mode: mode.pole.imag)
    return Subject(tracked, tuple(modes))


def poles_to_cancel(subjects: Sequence[Subject], sample_rate_Hz: float) -> list[tuple[complex, ...]]:
    """Return the lightly damped poles of every subject that are not fast and that the axis excites, the same ones by order of frequency.

    Raises
    ------
    DesignError
        The number of slow modes differs between poses.
    """
    alike = [_modes_below(SLOW * sample_rate_Hz, each) for each in subjects]
    if len({len(modes) for modes in alike}) > 1:
        raise DesignError(f"the poses have {[len(modes) for modes in alike]} ringing modes: no schedule over them; shape pose by pose")
    slow = [_modes_below(FAST * sample_rate_Hz, each) for each in subjects]
    slow = [modes[: min(map(len, slow))] for modes in slow]  # rising in frequency: one that leaves the band at a pose is left out
    seen = np.zeros(len(slow[0]), dtype=bool)
    for modes in slow:
        acceleration = np.array([mode.step_share * mode.frequency_rad_s**2 for mode in modes])
        seen |= acceleration > SEEN * acceleration.max(initial=0.0)
    found = []
    for each, modes in zip(subjects, slow, strict=True):
        poles = each.dynamics.poles
        wanted = [mode.pole for mode, chosen in zip(modes, seen, strict=True) if chosen]
        found.append(tuple(complex(poles[np.argmin(np.abs(poles - pole))]) for pole in wanted))
    return found


def _modes_below(frequency_Hz: float, subject: Subject) -> list[Mode]:
    return sorted(
        (mode for mode in subject.ringing if mode.frequency_rad_s < 2.0 * np.pi * frequency_Hz), key=lambda mode: mode.frequency_rad_s
    )


def delay_map(
    conditions: Sequence[Sequence[Condition]],
    subjects: Sequence[Subject],
    sample_period_s: float,
    longest_s: float,
    tail: Dynamics | None = None,
    ahead_s: float = 0.0,
) -> list[MapRow]:
    """Return harmonic filters for every delay T of whole samples whose transient fits, as in Fig. 7.12; unsolvable delays are left out.

    With a tail on the last tap, which stands `ahead_s` earlier.
    """
    taps = tap_count(conditions[0])
    rows = []
    for samples in range(1, int(longest_s / sample_period_s / max(taps - 1, 1)) + 1):
        delay_s = samples * sample_period_s
        try:
            filters = tuple(harmonic(each, delay_s, tail=tail, ahead_s=ahead_s) for each in conditions)
        except DesignError:
            continue
        worst = max(
            vibration_left(shaper, each.ringing, share) for shaper, each in zip(filters, subjects, strict=True) for share in (-0.1, 0.1)
        )
        sums, largest = max(shaper.gain_sum for shaper in filters), max(shaper.largest_gain for shaper in filters)
        rows.append(MapRow(delay_s, filters, sums, largest, filters[0].transient_s, worst))
    return rows


def choose_delay(rows: Sequence[MapRow], longest_s: float) -> MapRow:
    """Choose a delay: the least transient (as a share of the available time) plus vibration at 10 percent, with gains within the limit.

    Where gains are too large everywhere, the delay with the smallest gains is chosen.

    Raises
    ------
    DesignError
        The map is empty.
    """
    if not rows:
        raise DesignError(f"no delay fits its filter into {longest_s:.4g} s: allow a longer transient, or fewer harmonics or robust poles")
    fitting = [row for row in rows if row.gain_sum <= GAIN_LIMIT]
    if not fitting:
        return min(rows, key=lambda row: row.gain_sum)
    return min(fitting, key=lambda row: row.transient_s / longest_s + row.vibration_at_10)


def design_all(
    subjects: Sequence[Subject],
    aim: Aim,
    sample_rate_Hz: float,
    quiet_band_Hz: tuple[float, float] = QUIET_BAND_Hz,
    also: Sequence[str] = (),
) -> Candidates:
    """Design point-to-point, notch and harmonic shapers for these poses, the recommended one first and those with objections last.

    `also` names designs of `ALSO` beside them.

    Raises
    ------
    DesignError
        The plant is unstable, no mode rings, a forcing frequency lies on a pole, no harmonic filter fits the available time, or `also`
        names no design.
    """
    for name in also:
        if name not in ALSO:
            raise DesignError(f"design {name!r}: must be of {', '.join(ALSO)}")
    period_s = 1.0 / sample_rate_Hz
    check_band(quiet_band_Hz, period_s)
    cancelled = poles_to_cancel(subjects, sample_rate_Hz)
    if not cancelled[0]:
        raise DesignError(_nothing_to_cancel(subjects[0], sample_rate_Hz))
    conditions = [
        harmonic_conditions(each.dynamics, aim.forcing_rad_s, poles, robust_forcing_rad_s=aim.without_slope_rad_s)
        for each, poles in zip(subjects, cancelled, strict=True)
    ]
    robust = [
        harmonic_conditions(each.dynamics, aim.forcing_rad_s, poles, robust_poles=poles, robust_forcing_rad_s=aim.without_slope_rad_s)
        for each, poles in zip(subjects, cancelled, strict=True)
    ]
    found = [tuple(_named(DelayFilter(np.zeros(1), np.ones(1)), "none") for _ in subjects)]
    found += [_common(subjects, cancelled, make, name, period_s) for make, name in _POINT_TO_POINT]
    found.append(_common(subjects, cancelled, zv, "ZV all", period_s, every_mode=True))
    found.append(tuple(_notch(poles, period_s) for poles in cancelled))
    refused: dict[str, str] = {}
    for each, name in zip((conditions, robust), HARMONIC, strict=False):
        try:
            row = choose_delay(delay_map(each, subjects, period_s, aim.longest_transient_s), aim.longest_transient_s)
            found.append(tuple(_named(shaper, name) for shaper in row.filters))
        except DesignError as error:
            refused[name] = str(error)
    longest = _whole(aim.longest_transient_s, sample_rate_Hz)
    try:
        found.append(tuple(quiet(each, period_s, longest, quiet_band_Hz) for each in robust))
    except DesignError as error:
        refused["hTDF quiet"] = str(error)
        if len(refused) == len(HARMONIC):
            raise
    for name in dict.fromkeys(also):
        try:
            found.append((_further(name, subjects, conditions, aim.longest_transient_s, period_s),))
        except DesignError as error:
            refused[INVERTED.get(name, SHORTEST)] = str(error)
    designs = [Design(filters, judge(filters, subjects, aim, cancelled), tuple(cancelled)) for filters in found]
    return Candidates(recommended_first(designs), refused)


def recommended_first(designs: Iterable[Design]) -> tuple[Design, ...]:
    """Return designs by what they cost, those with objections last."""
    return tuple(sorted(designs, key=lambda design: (bool(design.verdict.against), design.verdict.cost)))


def _further(
    name: str, subjects: Sequence[Subject], conditions: Sequence[Sequence[Condition]], longest_s: float, period_s: float
) -> DelayFilter:
    """Return a design of `ALSO` for one pose."""
    if len(subjects) > 1:
        raise DesignError("it is made for one pose: leave out the schedule")
    taps, path = tap_count(conditions[0]), subjects[0].dynamics
    if name == "shortest":
        continuous = shortest_delays(conditions[0], longest_s / max(taps - 2, 1), gain_sum_limit=GAIN_LIMIT, count=1)[0]
        return _named(on_samples(continuous, conditions[0], period_s), SHORTEST)
    tail, ahead_s = tail_of(path, name, invertible(path, longest_s))
    if tail is None:
        raise DesignError(f"the path has no zero whose inverse settles within {longest_s:.4g} s")
    left_s = longest_s - DelayFilter(np.zeros(1), np.ones(1), tail).settled_s
    return _named(choose_delay(delay_map(conditions, subjects, period_s, left_s, tail, ahead_s), left_s).filters[0], INVERTED[name])


def shaper_of(design: Design, axis: str, sample_rate_Hz: float, positions: Sequence[float] = (0.0,), schedule_axis: str = "") -> AxisShaper:
    """Return a design in the form in which the loop runs it."""
    return axis_shaper(axis, design.filters, sample_rate_Hz, positions, schedule_axis, design.verdict.static_gain)


_Maker = Callable[[float, float], DelayFilter]
_POINT_TO_POINT: tuple[tuple[_Maker, str], ...] = ((zv, "ZV"), (zvd, "ZVD"), (ei, "EI"), (two_hump_ei, "2HEI"))


def _common(
    subjects: Sequence[Subject],
    cancelled: Sequence[Sequence[complex]],
    make: _Maker,
    name: str,
    period_s: float,
    every_mode: bool = False,
) -> tuple[DelayFilter, ...]:
    """Design a point-to-point shaper on samples for the mode that rings most (or for all) at the middle pose.

    It serves all poses, because its delays cannot be scheduled.
    """
    middle = len(subjects) // 2
    weight = {mode.pole: mode.step_share * mode.frequency_rad_s**2 for mode in subjects[middle].ringing}
    poles = list(cancelled[middle])
    if not every_mode:
        poles = [max(poles, key=lambda p: weight[min(weight, key=lambda q: abs(q - p))])]
    shaper = multi_mode(make, [(abs(pole), -pole.real / abs(pole)) for pole in poles])
    conditions = [Condition(0.0, 1.0, 0, "DC gain")]
    conditions += [Condition(c.s, complex(shaper.response(c.s)), 0, c.what) for c in cancelling(poles)]
    return tuple(_named(on_samples(shaper, conditions, period_s), name) for _ in subjects)


def _notch(poles: Sequence[complex], period_s: float) -> DelayFilter:
    """Return a filter with zeros at the poles, as many well-damped poles at their frequencies, and DC gain 1."""
    wide = [complex(-NOTCH_DAMPING * abs(p), np.sqrt(1.0 - NOTCH_DAMPING**2) * abs(p)) for p in poles]
    in_z = [np.exp(np.array([*roots, *np.conj(roots)]) * period_s) for roots in (list(poles), wide)]
    system = Dynamics.from_polynomials(np.real(np.poly(in_z[0])), np.real(np.poly(in_z[1])), period_s)
    return DelayFilter(np.zeros(1), np.ones(1), system.scaled(1.0 / complex(system.response(0.0)).real), "notch")


def _nothing_to_cancel(subject: Subject, sample_rate_Hz: float) -> str:
    """Say why no mode is cancelled: there is none, or all are fast, and what can be done about the one that rings most."""
    limit = FAST * sample_rate_Hz
    if not subject.ringing:
        return f"no mode of this axis is damped by less than {LIGHTLY_DAMPED:g}: nothing rings, so there is nothing to shape away"
    most = max(subject.ringing, key=lambda mode: mode.step_share * mode.frequency_rad_s**2)
    frequency_Hz = most.frequency_rad_s / (2.0 * np.pi)
    return (
        f"the mode at {frequency_Hz:.4g} Hz (damping {most.damping:.2g}) is above {limit:.3g} Hz, a third of the sample rate, up to which "
        f"modes are shaped: raise timing.sample_rate_Hz to {math.ceil(frequency_Hz / FAST):d}, damp the mode, or limit the jerk"
    )


def _named(shaper: DelayFilter, name: str) -> DelayFilter:
    return DelayFilter(shaper.delays_s, shaper.gains, shaper.tail, name)


def _whole(seconds: float, sample_rate_Hz: float) -> float:
    """Return the available time less one sample, because the shaped scan must be at rest before it is over."""
    whole: float = (np.ceil(seconds * sample_rate_Hz - 1e-9) - 1.0) / sample_rate_Hz
    return whole

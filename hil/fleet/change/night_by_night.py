"""Night by night over a fleet: who changed, since when, how sure; and what changed on every machine at once.

Everything that is said of a night uses results until then only. The model of scatter is learned after `SETTLING` nights and again whenever
their number has doubled; the bank then goes over the past once more. So the answer to a night is the same whenever it is asked for.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from hil.errors import UnusableInputError
from hil.fleet.change.bank import Bank
from hil.fleet.change.course import course_of
from hil.fleet.change.scatter_model import FEWEST, FleetModel, adjusted, fit_model
from hil.fleet.change.threshold import SETTLING, STATED_PER_MACHINE_YEAR, YEAR, threshold
from hil.fleet.change.tracks import Parameter, Tracks

FEWEST_DIFFERENCES = 10
"""Nightly differences of a parameter, over all machines, from which its scatter is known."""

SHOWN = 7
"""Nights of which the median is said as the value now."""

BEFORE = 28
"""Nights of which the median is said as the value before."""


@dataclass(frozen=True)
class Change:
    """A machine's own change of one parameter.

    Parameters
    ----------
    machine : str
    parameter : Parameter
    kind : "step" or "growth"
    sigma : float
        Greatest evidence since the alarm, in standard deviations; the sign is the direction.
    alarm : numpy.datetime64
        Night on which the evidence first passed the threshold.
    since, since_from, since_to : numpy.datetime64
        When it began, with a 95 % interval.
    before, now : float
        Medians before it began and now, what is common to the fleet taken off, in the parameter's unit.
    deviation : float
        Standard deviation of `now - before`.
    also : tuple of Parameter
        Parameters that changed as well, beyond what their correlation with this one explains.
    """

    machine: str
    parameter: Parameter
    kind: str
    sigma: float
    alarm: np.datetime64
    since: np.datetime64
    since_from: np.datetime64
    since_to: np.datetime64
    before: float
    now: float
    deviation: float
    also: tuple[Parameter, ...] = ()


@dataclass(frozen=True, eq=False)
class FleetChange:
    """The answer over a fleet.

    Parameters
    ----------
    tracks : Tracks
    changes : tuple of Change
        Machines that need a visit, the most certain first.
    common : (T, P) array
        What is common to the fleet, in each parameter's unit, against the first nights; 0 where the fleet is too small to tell.
    evidence : (M, P) array
        The greatest evidence of each machine and parameter now, in standard deviations, with its sign.
    threshold : float
        In standard deviations.
    per_machine_year : float
        Stated rate of false alarms.
    watched : (P,) array of bool
        Parameters with enough results.
    model : FleetModel or None
        None before `SETTLING` nights.
    watched_years : float
        Machine-years over which alarms could be raised.
    """

    tracks: Tracks
    changes: tuple[Change, ...]
    common: np.ndarray
    evidence: np.ndarray
    threshold: float
    per_machine_year: float
    watched: np.ndarray
    model: FleetModel | None = None
    watched_years: float = 0.0
    notes: tuple[str, ...] = field(default=())


def fleet_change(tracks: Tracks, per_machine_year: float = STATED_PER_MACHINE_YEAR) -> FleetChange:
    """Find what changed.

    Parameters
    ----------
    tracks : Tracks
    per_machine_year : float
        False alarms a machine and year, over all of its parameters.

    Raises
    ------
    UnusableInputError
        The rate is not between 0 and 1.
    """
    if not 0.0 < per_machine_year < 1.0:
        raise UnusableInputError(f"false alarms a machine and year {per_machine_year:g}: must be between 0 and 1, such as 0.01")
    watching = _Watching(tracks, per_machine_year)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "All-NaN slice|Mean of empty slice", RuntimeWarning)  # a machine without a parameter is no fault
        for learned, end in _stretches(len(tracks.nights)):
            watching.stretch(learned, end)
        return watching.answer()


def _stretches(nights: int) -> Iterator[tuple[int, int]]:
    """Yield up to which night the model learns, and until which it is used."""
    learned = SETTLING
    while learned < nights:
        yield learned, min(2 * learned, nights)
        learned *= 2


class _Watching:
    """The bank over the nights, and the alarms so far."""

    def __init__(self, tracks: Tracks, per_machine_year: float) -> None:
        shape = tracks.values.shape
        self.tracks, self.per_machine_year = tracks, per_machine_year
        self.alarms = np.full(shape[0], shape[1])  # night of the first, T for none
        self.blamed = np.full(shape[0], -1)
        self.greatest = np.zeros(shape[0])  # evidence of the blamed parameter from the alarm on
        self.also: dict[int, list[int]] = {}
        self.watched = np.zeros(shape[2], dtype=bool)
        self.threshold = np.inf
        self.model: FleetModel | None = None
        self.bank: Bank | None = None
        self.days = (tracks.nights - tracks.nights[0]).astype(int) if len(tracks.nights) else np.zeros(0, dtype=int)
        self.released, self.fleet_released = _releases(tracks.builds)

    def stretch(self, learned: int, end: int) -> None:
        tracks = self.tracks
        past = tracks.until(learned)
        steps = np.isfinite(np.diff(past.values, axis=1)).sum(axis=(0, 1))
        self.watched = steps >= FEWEST_DIFFERENCES
        if not self.watched.any():
            return
        self.model = model = fit_model(past)
        u, measured = adjusted(tracks.until(end), model.scale, model.adjustment)
        u[..., ~self.watched] = np.nan
        self.threshold = threshold(int(self.watched.sum()), model.bad_nights, self.per_machine_year)
        self.bank = bank = Bank(len(tracks.machines), model)
        for night in range(end):
            in_fleet = np.ones(u[:, 0].shape, dtype=bool)
            alarmed = np.flatnonzero(self.alarms <= night)
            in_fleet[alarmed, self.blamed[alarmed]] = False
            highest = bank.night(
                self.days[night], u[:, night], measured[:, night], in_fleet, self.released[:, night], self.fleet_released[night]
            )
            if night >= learned:
                named = highest.max(axis=1) > self.threshold
                for machine in np.flatnonzero(named & (self.alarms == len(tracks.nights))):
                    self.alarms[machine] = night
                    self._blame(int(machine), bank.evidence_of(int(machine)))
                alarmed = np.flatnonzero(self.alarms <= night)
                self.greatest[alarmed] = np.maximum(self.greatest[alarmed], highest[alarmed, self.blamed[alarmed]])

    def _blame(self, machine: int, evidence: np.ndarray) -> None:
        """Name the parameter that explains the evidence best: of those that pass the threshold, by what the nights say when none is cut.

        Where two are correlated, a change of one passes in both; cut, a great change is as clear in either.
        """
        assert self.bank is not None
        assert self.model is not None
        _, begun, kind = np.unravel_index(np.abs(evidence).argmax(), evidence.shape)
        uncut = self.bank.uncut_of(machine)[:, begun, kind]
        cut = np.abs(evidence[:, begun, kind])
        first = int((np.abs(uncut) * (cut > self.threshold)).argmax())
        self.blamed[machine] = first
        shared = self.model.correlation[first]
        others = (uncut - shared * uncut[first]) / np.sqrt(np.maximum(1.0 - shared**2, 1e-6))
        others[first] = 0.0
        self.also[machine] = [int(j) for j in np.flatnonzero((np.abs(others) > self.threshold) & (cut > self.threshold))]

    def answer(self) -> FleetChange:
        tracks, bank = self.tracks, self.bank
        shape = tracks.values.shape
        common = self._common()
        notes = []
        if bank is None:
            notes.append(f"{shape[1]} nights: scatter is learned from {SETTLING}, and nothing is said before the next")
        if shape[0] < FEWEST:
            notes.append(
                f"with {shape[0]} machines, fewer than {FEWEST}, what a season does to all is not told from a machine's own change"
            )
        evidence = np.zeros((shape[0], shape[2]))
        changes = []
        if bank is not None:
            for machine in range(shape[0]):
                flat = bank.evidence_of(machine).reshape(shape[2], -1)
                evidence[machine] = flat[np.arange(shape[2]), np.abs(flat).argmax(axis=1)]
            changes = [self._change(int(m), common) for m in np.flatnonzero(self.alarms < shape[1])]
        changes.sort(key=lambda change: -abs(change.sigma))
        first = min(SETTLING, shape[1])
        years = float(np.maximum(np.minimum(self.alarms, shape[1]) - first, 0).sum()) / YEAR
        return FleetChange(
            tracks, tuple(changes), common, evidence, self.threshold, self.per_machine_year, self.watched, self.model, years, tuple(notes)
        )

    def _common(self) -> np.ndarray:
        """Return what all machines share, by parameter: the median over the machines, each less its own middle."""
        values = self.tracks.values
        if len(values) < FEWEST or not len(self.tracks.nights):
            return np.zeros(values.shape[1:])
        sound = values.copy()
        for machine in np.flatnonzero(self.alarms < values.shape[1]):
            sound[machine, :, self.blamed[machine]] = np.nan
        own = sound - np.nanmedian(sound, axis=1, keepdims=True)
        common = np.nan_to_num(np.nanmedian(own, axis=0))
        return np.asarray(common - np.median(common[:SHOWN], axis=0))

    def _change(self, machine: int, common: np.ndarray) -> Change:
        assert self.model is not None
        tracks, j = self.tracks, int(self.blamed[machine])
        own = tracks.values[machine, :, j] - common[:, j]
        known = np.flatnonzero(np.isfinite(own))
        course = course_of(self.days[known].astype(float), own[known])
        since, since_from, since_to = (tracks.nights[known[place]] for place in course[1:])
        base, after = known[: course.since][-BEFORE:], known[course.since :]
        shown = after[-SHOWN:] if course.kind == "growth" else after
        scatter = self.model.scale[j] ** 2
        earlier, now = float(np.median(own[base])), float(np.median(own[shown]))
        sigma = float(np.copysign(self.greatest[machine], now - earlier))
        deviation = np.sqrt(np.pi / 2.0 * scatter * (1.0 / max(len(base), 1) + 1.0 / max(len(shown), 1)))
        return Change(
            tracks.machines[machine], tracks.parameters[j], course.kind, sigma, tracks.nights[self.alarms[machine]],
            since, since_from, since_to, earlier, now, float(deviation),
            tuple(tracks.parameters[k] for k in self.also.get(machine, ())),
        )  # fmt: skip


def _releases(builds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return on which nights machines (M, T), and the fleet (T,), came with another software version or machine file than before.

    Where most machines of a night come with another build, it is the fleet's: what that shifts is common to all.
    """
    machines, nights = builds.shape[:2]
    released, fleet = np.zeros((machines, nights), dtype=bool), np.zeros(nights, dtype=bool)
    last = builds[:, 0].copy() if nights else builds
    of_all = {tuple(build) for build in last}
    for night in range(1, nights):
        here = builds[:, night, 0] >= 0
        other = here & (last[:, 0] >= 0) & (builds[:, night] != last).any(axis=1)
        if other.sum() * 2 > here.sum() and machines >= FEWEST:
            fleet[night] = True
            of_all = {tuple(build) for build in builds[other, night]}
        released[:, night] = other & ~np.array([tuple(build) in of_all for build in builds[:, night]])
        last[here] = builds[here, night]
    return released, fleet

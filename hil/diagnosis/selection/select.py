"""The machine that predicts best what it was not fitted to: sets of effects are proposed, fitted and judged by free runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.diagnosis.candidates.entries import setting_of
from hil.diagnosis.likelihood.fitting import Fit, Fitting
from hil.diagnosis.likelihood.inverse import Inverse
from hil.diagnosis.likelihood.judge import Judge
from hil.diagnosis.model_choice.everyday import everyday_effects
from hil.diagnosis.observed.rows import between_samples, observed
from hil.diagnosis.residuals.assumed_noise import efforts_by_encoders
from hil.diagnosis.residuals.trajectory import Trajectory
from hil.diagnosis.retuning.linear_model import ZERO_m, ZERO_rad
from hil.diagnosis.selection.candidates import EquationErrors
from hil.diagnosis.selection.rivals import Rival, around, rivals
from hil.diagnosis.selection.search import Search
from hil.diagnosis.simulation.closed_loop import ClosedLoop
from hil.diagnosis.simulation.windows import OpenLoop, Simulated
from hil.diagnosis.unknowns.unknowns import Kind, Point, Unknown, Unknowns, numbers_of
from hil.machine import Machine
from hil.recording import Recording
from virtual_bus.effects.bounds import effect_at
from virtual_bus.settings import EffectSetting

EXCHANGES = 2
"""Of an effect for another law that predicts better in its place, each followed by a search, at most."""
HORIZONS_s = (0.1, 0.3, 1.0, 2.0, 6.0)
"""Of windows in open loop: each longer one begins from what the shorter ones found."""
NEAR = 0.5
"""Error of a horizon, as a share of what moves within it, above which a simulation says little more than its drift."""
ASTRAY = 2.0
"""Factor by which shorter windows become worse where longer ones led into a false minimum: motion that is another one from its start on."""
FEWEST_WINDOWS, FEWEST_ROWS = 2, 8
STAMPS = 0.2
"""Standard deviation of an effort's lateness against a position's in the same row [rows]."""
POWER, VISCOUS, OF_LOAD = "power_law_friction", "viscous_friction", "load_dependent_friction"
LOADED = 0.1
"""Share of a drive's effort that a load must make for its friction to be told from an inertia: what is left of a law is a tenth of it."""
STARTS = ((Kind.LATENESS, 0.0), (Kind.LATENESS, 1.0 / STAMPS), (Kind.LATENESS, 2.0 / STAMPS), (Kind.SPEED_LIMIT, 2.0))
"""From which fits of a closed loop begin: a reference as recorded, one and two rows later, and limited to three quarters of its speed."""


@dataclass(frozen=True, eq=False)
class Selected:
    """What was found.

    Attributes
    ----------
    search : Search
    fit : Fit
        The machine that predicts best.
    baseline : Fit
        The engineer's.
    plain : Fit
        Numbers alone.
    accepted : tuple of int
        Effects of the best machine that are missed without them.
    rivals : tuple of Rival
        Machines without one of them.
    of : EquationErrors
        The best machine with all laws beside it.
    closed : bool
        Whether the closed loop was simulated, from its references on.
    """

    search: Search
    fit: Fit
    baseline: Fit
    plain: Fit
    accepted: tuple[int, ...]
    rivals: tuple[Rival, ...]
    of: EquationErrors
    closed: bool

    @property
    def unknowns(self) -> Unknowns:
        """Numbers that were free."""
        return self.search.fitting.unknowns


def is_closed(machine: Machine, recordings: Mapping[str, Recording]) -> bool:
    """Return whether recordings have all that the machine's loop was given."""
    names = [f"reference_{axis}" for axis in machine.axes]
    recorded = all(name in one and np.isfinite(one[name]).any() for one in recordings.values() for name in names)
    return bool(machine.controllers) and recorded


def runs_of(
    machine: Machine, recordings: Mapping[str, Recording], closed: bool, first: int = 0
) -> tuple[list[Trajectory], list[Simulated]]:
    """Return the recordings' motions, and free runs beside them, numbered from `first` on.

    There are no runs where no encoder follows a joint, or recordings have not the same channels.
    """
    every = [between_samples(observed(machine, name, recording)) for name, recording in recordings.items()]
    trajectories = [Trajectory(one) for one in every]
    numbered = enumerate(zip(every, trajectories, strict=True), first)
    if not all(trajectory.smooth for trajectory in trajectories):
        return trajectories, []
    runs: list[Simulated] = [ClosedLoop(k, one) if closed else OpenLoop(k, one, trajectory) for k, (one, trajectory) in numbered]
    return trajectories, runs if all(run.channels == runs[0].channels for run in runs) else []


def select(
    machine: Machine, recordings: Mapping[str, Recording], say: Callable[[str], None] = lambda what: None, jobs: int | None = None
) -> Selected | None:
    """Select effects and numbers by free runs; None where these cannot begin, or stay near the recordings over no horizon.

    Simulations take `jobs` processors at most, all by default.
    """
    closed = is_closed(machine, recordings)
    trajectories, runs = runs_of(machine, recordings, closed)
    if not runs:
        return None
    unknowns = _unknowns(machine, runs, closed)
    inverse = Inverse(trajectories, unknowns)
    everyday = everyday_effects(trajectories[0])
    of_sets = [inverse.fits(unknowns.start(each)) for each in engineers_sets(trajectories, everyday)]
    say(f"inverse: {_words(unknowns, of_sets[0][0])}")
    grown = _grown(runs, unknowns, of_sets[0], closed, say, jobs)
    if grown is None:
        return None
    fitting, found = grown
    baseline = min((one for one in found if one is not None), key=lambda one: one.cost)
    search = Search(fitting, inverse, say)
    others = [fitting.fit(fitting.based(replace(each[0], held=frozenset()))) for each in of_sets[1:]]
    others += search.from_the_file(unknowns.start(everyday), baseline)
    best = search.best([baseline, *(one for one in others if one is not None)])
    near = around(search, best)
    accepted, against = rivals(search, best, near)
    for _ in range(EXCHANGES):
        better = min((one for one in against if one.has_another and one.fit is not None), key=lambda one: one.behind, default=None)
        if better is None or better.fit is None:
            break
        further = search.worth(better.settings[-1:]) - search.worth([best.point.settings[better.without]])
        if not search.is_better(better.fit, best, max(further, 0.0)):
            break
        say(f"exchanged: {_words(unknowns, better.fit.point)}")
        best = search.best([better.fit])
        near = around(search, best)
        accepted, against = rivals(search, best, near)
    while len(accepted) < len(best.point.settings):  # all together are fitted and judged anew, so that the answer is what is named
        sparer = fitting.fit(fitting.based(replace(best.point, settings=tuple(best.point.settings[k] for k in accepted))))
        if sparer is None:
            break
        best = sparer
        near = around(search, best)
        accepted, against = rivals(search, best, near)
    plain = fitting.fit(fitting.based(replace(inverse.fits(unknowns.start())[0], held=frozenset())))
    return Selected(search, best, baseline, baseline if plain is None else plain, accepted, against, near.of, closed)


def engineers_sets(trajectories: Sequence[Trajectory], everyday: Sequence[EffectSetting]) -> list[tuple[EffectSetting, ...]]:
    """Return the sets that an engineer would try: everyday effects; a power of speed in place of viscous friction; friction of the load.

    Friction of the load is tried where something loads an axis: elsewhere it does what another inertia does.
    """
    of = trajectories[0].settings
    power = tuple(setting_of(effect_at(POWER, each.at, of), each.at, {}) if each.name == VISCOUS else each for each in everyday)
    loaded = [drive.axis for drive in of.drives if any(_is_loaded(trajectory, drive.joint) for trajectory in trajectories)]
    of_load = tuple(setting_of(effect_at(OF_LOAD, axis, of), axis, {}) for axis in loaded)
    sets = [tuple(everyday), power]
    return sets + ([(*each, *of_load) for each in sets] if of_load else [])


def _is_loaded(trajectory: Trajectory, joint: str) -> bool:
    """Return whether what hangs on a joint asks for much of its effort."""
    k = trajectory.joints.index(joint)
    motion = efforts_by_encoders(trajectory)[0]
    still = replace(motion, speed=np.zeros_like(motion.speed), acceleration=np.zeros_like(motion.acceleration))
    held = trajectory.signals(still, trajectory.model(trajectory.plant.nominal))
    return k in trajectory.smooth and float(np.std(held.needed[:, k])) > LOADED * float(np.std(held.given[:, k]))


def _unknowns(machine: Machine, runs: Sequence[Simulated], closed: bool) -> Unknowns:
    found = numbers_of(runs[0].simulator.plant)  # type: ignore[attr-defined]
    held = {f"{drive.axis}.constant" for drive in machine.plant.drives}
    kept = [one for one in found.each if one.name not in held or found.plant.parameters[one.place].tolerance is not None]
    further = [Unknown("lateness", Kind.LATENESS, 0, 0.0, STAMPS * runs[0].period_s)]
    encoders = {encoder.channel: encoder for encoder in machine.plant.encoders if not encoder.absolute}
    kinds = {joint.name: joint.kind for joint in machine.plant.tree.joints}
    for run in runs:
        for c, channel in enumerate(run.channels):
            if channel in encoders and not closed:
                unit = ZERO_m if kinds[encoders[channel].joints[0]] == "prismatic" else ZERO_rad
                further.append(Unknown(f"{channel}.zero", Kind.ZERO, c, 0.0, unit, recording=run.number))
    if closed:
        for axis, name in enumerate(machine.axes):
            further.append(Unknown(f"{name}.controller_gain", Kind.GAIN, axis, 1.0, 0.15, is_log=True))
            further.append(Unknown(f"{name}.command_early", Kind.EARLY, axis, 0.0, STAMPS, is_left_out=True, most=1.0))
            values = np.concatenate([run.recorded[:, c] for run in runs for c, a in run.axis_of.items() if a == axis])  # type: ignore[attr-defined]
            fastest = max(float(np.nanmax(np.abs(np.diff(run.recorded_reference[:, axis]) / np.diff(run.recorded_time)))) for run in runs)  # type: ignore[attr-defined]
            if fastest > 0.0:
                further.append(Unknown(f"{name}.speed_limit", Kind.SPEED_LIMIT, axis, fastest, -0.15, is_log=True))
            if len(values):
                size = max(float(np.nanstd(values)), 1e-9)
                further.append(Unknown(f"{name}.effort_zero", Kind.EFFORT_ZERO, axis, 0.0, 0.1 * size))
                further.append(Unknown(f"{name}.effort_lag", Kind.EFFORT_LAG, axis, 0.0, runs[0].period_s, is_left_out=True))
    return replace(found, each=(*kept, *further))


def _grown(
    runs: Sequence[Simulated], unknowns: Unknowns, points: Sequence[Point], closed: bool, say: Callable[[str], None], jobs: int | None
) -> tuple[Fitting, list[Fit | None]] | None:
    """Fit machines to longer and longer windows; return the last fits, or None where not even the shortest stay near.

    A longer window is kept while its error stays below NEAR of what moves in it, and shorter ones do not become worse for it: where a
    machine falls, a long window tells more of where it began than of its laws.
    """
    total, longest = sum(run.rows * run.period_s for run in runs), max(run.rows * run.period_s for run in runs)
    grid: list[float | None] = [None]
    if not closed:
        fits_in = [h for h in HORIZONS_s if h >= FEWEST_ROWS * runs[0].period_s and h * FEWEST_WINDOWS <= total and h < longest]
        grid = [*fits_in, *([None] if longest <= HORIZONS_s[-1] * (1.0 + STAMPS) else [])] or [None]
    points, kept, lead = list(points), None, 0
    which: tuple[float | None, ...] = ()
    for horizon in grid:
        judge = Judge(runs, (*which, horizon), jobs)
        fitting = Fitting(judge, unknowns, np.full(judge.shape, 50.0))
        (first,) = fitting.at(points[lead : lead + 1])
        if first is None:
            break
        fitting = fitting.with_weights(judge.weights_of(first.reduced))
        if kept is None:
            points = [fitting.based(point) for point in points]
        before = [math.inf if one is None else one.mean_squares for one in fitting.at(points)]
        found = [_best(fitting, point, closed) for point in points]
        lead = min(range(len(found)), key=lambda k: math.inf if (one := found[k]) is None else one.cost)
        if (best := found[lead]) is None:
            break
        relative = np.sqrt(best.mean_squares / judge.moved)
        worse = float(np.sqrt(np.max((best.mean_squares / before[lead])[:-1], initial=0.0)))
        say(f"horizon {horizon}: errors {relative.round(4).tolist()}, weights {fitting.weights.round(0).tolist()}, shorter x {worse:.2f}")
        if float(relative[-1].max()) > NEAR or worse > ASTRAY:
            break
        which, kept = judge.horizons, (fitting, found, lead)
        points = [point if one is None else one.point for one, point in zip(found, points, strict=True)]
    if kept is None:
        return None
    fitting, found, lead = kept
    best = found[lead]
    assert best is not None
    fitting = fitting.with_weights(fitting.judge.weights_of(best.reduced))
    return fitting, [None if one is None else fitting.fit(one.point) for one in found]


def _best(fitting: Fitting, point: Point, closed: bool) -> Fit | None:
    """Return the best fit from a point on and, in closed loop, from others whose reference is later or limited.

    Inertias imitate a lateness and the other way round, and a limit does nothing before it is reached.
    """
    which = {one.kind: k for k, one in enumerate(fitting.unknowns.each) if k not in point.held}
    found = []
    for kind, shift in STARTS if closed else ((Kind.LATENESS, 0.0),):
        numbers = point.numbers.copy()
        if kind in which:
            numbers[which[kind]] += shift
        elif shift:
            continue
        fit = fitting.fit(replace(point, numbers=numbers))
        found += [] if fit is None else [fit]
    return min(found, key=lambda each: each.cost, default=None)


def _words(unknowns: Unknowns, point: Point) -> str:
    numbers = {one.name: round(float(at), 2) for one, at in zip(unknowns.each, point.numbers, strict=True) if abs(at) > 0.5}
    laws = [
        f"{each.name}@{each.at} " + ", ".join(f"{key} {value:.3g}" for key, value in each.parameters.items()) for each in point.settings
    ]
    return f"{numbers} {laws}"

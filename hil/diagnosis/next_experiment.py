"""The experiment that would tell hypotheses apart, found by optimisation within the machine's limits.

Atkinson and Fedorov 1975 (T-optimal designs), with the separation d of two free runs (separation.py) in place of a regression's. A bound
of d is taken for every draw first, and d itself only while a draw could be the best.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.optimize
from scipy.stats import qmc

from hil.diagnosis.experiment_families import FAMILIES, Family, Request, requests
from hil.diagnosis.noise import NoiseModel
from hil.diagnosis.separation import Model, Separation
from hil.errors import ExperimentError
from hil.experiments import Experiment, Plan
from hil.machine import Machine

DRAWS = 8
"""Quasi-random experiments of every family and axis that are looked at first: a power of two, as Sobol's sequence wants."""

REFINEMENTS = 30
"""Evaluations of the simplex search from the best of them."""

FIRST_STEP = 0.12
"""Of the simplex, as a share of every quantity's range."""

DRAWN = 0.5
"""Share of the search, for its report, after which the simplex begins."""

Report = Callable[[float], None]


@dataclass(frozen=True, eq=False)
class Proposal:
    """An experiment that separates hypotheses.

    Attributes
    ----------
    experiment : Experiment
        What `isocenter run` takes.
    separation : float
        Smallest predicted distance d of any pair with the likeliest hypothesis, in standard deviations of one recording's noise.
    seconds : float
        How long the recording is.
    runs : int
        Free runs it took.
    """

    experiment: Experiment
    separation: float
    seconds: float
    runs: int

    def header(self, names: Sequence[str]) -> str:
        """Comment lines for the experiment's file."""
        return (
            f"# Separates {' from '.join(names)}.\n"
            f"# Predicted separation: {self.separation:.3g} standard deviations of one recording's noise, in {self.seconds:.3g} s.\n"
        )


def propose(
    machine: Machine,
    models: Sequence[Model],
    noise: NoiseModel,
    channels: tuple[str, ...],
    *,
    jobs: int = 1,
    report: Report = lambda share: None,
) -> Proposal | None:
    """Find the experiment that separates the first model from each of the others best.

    Parameters
    ----------
    machine : Machine
        Its limits bound everything; without controllers there is nothing to run.
    models : sequence of Model
        Two or more, the likeliest first.
    noise : NoiseModel
        From the recordings so far.
    channels : tuple of str
        As recorded so far.
    jobs : int
        Processes.
    report : callable
        Told the share that is done.

    Returns
    -------
    Proposal or None
        None where the machine cannot be run, or nothing within its limits separates them.
    """
    if not machine.controllers or len(models) < 2:
        return None
    with Separation(machine, models, noise, channels, jobs) as separation:
        best = _best_draw(machine, separation, lambda share: report(DRAWN * share))
        if best is None:
            return None
        return _refined(machine, separation, best, lambda share: report(DRAWN + (1.0 - DRAWN) * share))


@dataclass(frozen=True, eq=False)
class _Draw:
    """A point of a family's cube."""

    request: Request
    point: np.ndarray
    plan: Plan
    separation: float


def _best_draw(machine: Machine, separation: Separation, report: Report) -> _Draw | None:
    """The draw of the largest d."""
    draws: list[_Draw] = []
    asked = requests(machine)
    for number, request in enumerate(asked):
        family = FAMILIES[request.family]
        points = qmc.Sobol(family.dimensions(machine), seed=0).random(DRAWS)
        planned = [(point, plan) for point in points if (plan := _plan(machine, family, request, point)) is not None]
        most = separation.at_most([plan for _, plan in planned])
        draws += [_Draw(request, point, plan, found) for (point, plan), found in zip(planned, most, strict=True)]
        report(0.5 * (number + 1) / len(asked))
    best: _Draw | None = None
    for number, draw in enumerate(sorted(draws, key=lambda draw: -draw.separation)):
        if draw.separation <= (0.0 if best is None else best.separation):
            break  # nor can those after it be better
        found = separation.of_plan(draw.plan)
        if found > (0.0 if best is None else best.separation):
            best = replace(draw, separation=found)
        report(0.5 + 0.5 * (number + 1) / len(draws))
    return best


def _refined(machine: Machine, separation: Separation, best: _Draw, report: Report) -> Proposal:
    """A simplex search from a draw."""
    family, start = FAMILIES[best.request.family], best.point
    done = 0

    def value(point: np.ndarray) -> float:
        nonlocal done
        done += 1
        report(min(done / REFINEMENTS, 1.0))
        plan = _plan(machine, family, best.request, point)
        return 0.0 if plan is None else separation.of_plan(plan)

    simplex = np.vstack([start, start + np.where(start < 0.5, FIRST_STEP, -FIRST_STEP) * np.eye(len(start))])
    refined = scipy.optimize.minimize(
        lambda point: -value(np.clip(point, 0.0, 1.0)), start, method="Nelder-Mead",
        options={"maxfev": REFINEMENTS, "initial_simplex": simplex},
    )  # fmt: skip
    experiment = family.experiment(machine, best.request, np.clip(refined.x, 0.0, 1.0))
    (plan,) = experiment.plans(machine)
    return Proposal(experiment, -float(refined.fun), plan.rows / machine.sample_rate_Hz, separation.count)


def _plan(machine: Machine, family: Family, request: Request, point: np.ndarray) -> Plan | None:
    """None where the machine's limits forbid it."""
    try:
        plans = family.experiment(machine, request, point).plans(machine)
    except ExperimentError:
        return None
    return plans[0]

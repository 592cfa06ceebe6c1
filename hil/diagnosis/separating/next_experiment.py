"""The experiment that would tell hypotheses apart, found by optimisation within the machine's limits.

Atkinson and Fedorov 1975 (T-optimal designs), with the separation d of two free runs (separation.py) in place of a regression's, in either
direction as likely as it is. An equation errs by a share of what it explains, so d^2 counts in units of their temperature T:
where an effect is large and another name differs from it by little, the difference proves nothing. Over several rivals the mean of
log(1 + d^2 / T) counts, each as likely as it is so far: the smallest alone would be ruled by a rival that nothing within the limits
separates. Distances without a refit rank all draws; the best of them are refitted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.optimize
from scipy.stats import qmc

from hil.diagnosis.judging.errors_of_laws import temperature
from hil.diagnosis.residuals.noise import NoiseModel
from hil.diagnosis.separating.experiment_families import FAMILIES, Family, Request, requests
from hil.diagnosis.separating.separation import Distances, Model, Separation
from hil.errors import ExperimentError
from hil.experiments import Experiment, Plan
from hil.machine import Machine

DRAWS = 16
"""Quasi-random experiments of every family and axis that are looked at first: a power of two, as Sobol's sequence wants."""

REFITTED = 8
"""Of the draws."""

REFINEMENTS = 30
"""Evaluations of the simplex search from the best of them, at most."""

LEAST_REFITTED, LEAST_REFINEMENTS = 3, 6
MOST_RUNS = 900
"""Free runs of a search, beyond which no more than these few draws are refitted and the simplex takes no more than these few steps: on a
machine of many numbers every refit takes many runs."""

FIRST_STEP = 0.12
"""Of the simplex, as a share of every quantity's range."""

TOLD_APART = 2.0
"""Standard deviations from which a separation is said to tell hypotheses apart."""

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
    models : tuple of Model
        What it separates, the likeliest first.
    separations : (rivals, 2) array
        Predicted distances d of the first from each of the others, in standard deviations of one recording's noise: where the first is
        right, and where the other one is.
    seconds : float
        How long the recording is.
    runs : int
        Free runs it took.
    """

    experiment: Experiment
    models: tuple[Model, ...]
    separations: np.ndarray
    seconds: float
    runs: int

    def header(self) -> str:
        """Comment lines for the experiment's file."""
        first, *others = [model.name for model in self.models]
        lines = [f"# Separates {first} from {' and from '.join(others)}, in {self.seconds:.3g} s."]
        lines.append("# Predicted separation, in standard deviations of one recording's noise:")
        for name, (if_first, if_other) in zip(others, self.separations, strict=True):
            lines.append(f"#   from {name}: {if_first:.3g} where {first} is right, {if_other:.3g} where {name} is")
        return "\n".join(lines) + "\n"

    def said(self, file: str) -> str:
        """One sentence of what the experiment in a file would show."""
        most = self.separations.max(axis=1)
        by = f"{' and '.join(f'{d:.3g}' for d in most)} standard deviations in {self.seconds:.3g} s"
        if np.all(most >= TOLD_APART):
            return f"{file} would tell them apart, by {by}"
        if np.any(most >= TOLD_APART):
            apart = [model.name for model, d in zip(self.models[1:], most, strict=True) if d >= TOLD_APART]
            return f"{file} would tell {self.models[0].name} from {' and from '.join(apart)} and not from the rest, by {by}"
        return f"no experiment was found that tells them apart; the best one, {file}, would separate them by {by}"


def propose(
    machine: Machine,
    models: Sequence[Model],
    shares: Sequence[float],
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
    shares : sequence of float
        How likely each is so far.
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
        search = _Search(machine, separation, np.array(shares))
        best = search.best_draw(lambda share: report(DRAWN * share))
        if best is None:
            return None
        point = search.refined(best, lambda share: report(DRAWN + (1.0 - DRAWN) * share))
        experiment = FAMILIES[best.request.family].experiment(machine, best.request, point)
        (plan,) = experiment.plans(machine)
        seconds = plan.rows / machine.sample_rate_Hz
        return Proposal(experiment, tuple(models), separation.of_plan(plan).separations, seconds, separation.count)


@dataclass(frozen=True, eq=False)
class _Draw:
    """A point of a family's cube."""

    request: Request
    point: np.ndarray
    plan: Plan
    worth: float


class _Search:
    """For the plan that is worth most."""

    def __init__(self, machine: Machine, separation: Separation, shares: np.ndarray) -> None:
        self._machine = machine
        self._separation = separation
        self._shares = shares
        self._runs_a_refit = 1.0

    def best_draw(self, report: Report) -> _Draw | None:
        """Of all families and axes; None where none of them separates anything."""
        draws: list[_Draw] = []
        asked = requests(self._machine)
        for number, request in enumerate(asked):
            family = FAMILIES[request.family]
            points = qmc.Sobol(family.dimensions(self._machine), seed=0).random(DRAWS)
            planned = [(point, plan) for point in points if (plan := _plan(self._machine, family, request, point)) is not None]
            most = self._separation.at_most([plan for _, plan in planned])
            draws += [_Draw(request, point, plan, self._worth(found)) for (point, plan), found in zip(planned, most, strict=True)]
            report(0.5 * (number + 1) / len(asked))
        refitted = []
        before = self._separation.count
        for number, draw in enumerate(sorted(draws, key=lambda draw: -draw.worth)[:REFITTED]):
            if number >= LEAST_REFITTED and self._separation.count > MOST_RUNS:
                break
            refitted.append(replace(draw, worth=self._of(draw.plan)))
            report(0.5 + 0.5 * (number + 1) / min(REFITTED, len(draws)))
        self._runs_a_refit = max((self._separation.count - before) / max(len(refitted), 1), 1.0)
        best = max(refitted, key=lambda draw: draw.worth, default=None)
        return None if best is None or best.worth <= 0.0 else best

    def refined(self, best: _Draw, report: Report) -> np.ndarray:
        """The point that a simplex search from a draw ends at."""
        family, start = FAMILIES[best.request.family], best.point
        left = (MOST_RUNS - self._separation.count) / self._runs_a_refit
        most = int(np.clip(left, LEAST_REFINEMENTS, REFINEMENTS))
        done = 0

        def worth(point: np.ndarray) -> float:
            nonlocal done
            done += 1
            report(min(done / most, 1.0))
            plan = _plan(self._machine, family, best.request, point)
            return 0.0 if plan is None else self._of(plan)

        simplex = np.vstack([start, start + np.where(start < 0.5, FIRST_STEP, -FIRST_STEP) * np.eye(len(start))])
        refined = scipy.optimize.minimize(
            lambda point: -worth(np.clip(point, 0.0, 1.0)), start, method="Nelder-Mead",
            options={"maxfev": most, "initial_simplex": simplex},
        )  # fmt: skip
        return np.clip(refined.x, 0.0, 1.0)

    def _of(self, plan: Plan) -> float:
        return self._worth(self._separation.of_plan(plan))

    def _worth(self, found: Distances) -> float:
        """Mean over who may be right, the first model or a rival, of log(1 + d^2 / T)."""
        first, rivals = self._shares[0], self._shares[1:]
        logs = np.log1p(found.separations**2 / temperature(found.removed, 0.0))
        return float(rivals @ (first * logs[:, 0] + rivals * logs[:, 1]) / (rivals @ (first + rivals)))


def _plan(machine: Machine, family: Family, request: Request, point: np.ndarray) -> Plan | None:
    """None where the machine's limits forbid it."""
    try:
        plans = family.experiment(machine, request, point).plans(machine)
    except ExperimentError:
        return None
    return plans[0]

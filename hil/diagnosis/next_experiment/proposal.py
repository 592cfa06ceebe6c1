"""The experiment that would tell sets of effects apart, sought within the machine's limits.

Atkinson and Fedorov 1975 (T-optimal designs), with the separation d of two sets (separation.py) in place of a regression's, in either
direction as likely as it is. Over several rivals the mean of log(1 + d^2) counts, each as likely as it is so far: the smallest alone would
be ruled by a rival that nothing within the limits separates. Distances of free runs rank all draws; to the best of them sets are fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from hil.diagnosis.next_experiment.experiment_families import FAMILIES, Family, Request, requests
from hil.diagnosis.next_experiment.separation import Model, Separation
from hil.diagnosis.residuals.equation_errors import Levels
from hil.errors import ExperimentError
from hil.experiments import Experiment, Plan
from hil.machine import Machine

DRAWS = 8
"""Quasi-random experiments of every family and axis: a power of two, as Sobol's sequence wants."""
FITTED = 3
"""Of the draws: the best by their free runs."""
TOLD_APART = 2.0
"""Standard deviations from which a separation is said to tell sets apart."""
FREE_RUNS = 0.5
"""Share of the search, for its report, after which fits begin."""


@dataclass(frozen=True, eq=False)
class Proposal:
    """An experiment that separates sets of effects.

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
    """

    experiment: Experiment
    models: tuple[Model, ...]
    separations: np.ndarray
    seconds: float

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
    levels: Levels,
    channels: tuple[str, ...],
    by: int = 1,
    report: Callable[[float], None] = lambda share: None,
) -> Proposal | None:
    """Find the experiment that separates the first set from each of the others best.

    Parameters
    ----------
    machine : Machine
        Its limits bound everything; without controllers there is nothing to run.
    models : sequence of Model
        Two or more, the likeliest first.
    levels : Levels
        Noise of one recording.
    channels : tuple of str
        Of sensors, as recorded so far.
    by : int
        Rows of the machine that are one row of what the levels are of.
    report : callable
        Told the share that is done.

    Returns
    -------
    Proposal or None
        None where the machine cannot be run, or nothing within its limits separates them.
    """
    if not machine.controllers or len(models) < 2:
        return None
    separation = Separation(machine, models, levels, channels, by)
    shares = np.array([model.share for model in models])
    drawn: list[tuple[float, Experiment, Plan]] = []
    asked = requests(machine)
    for number, request in enumerate(asked):
        family = FAMILIES[request.family]
        points = qmc.Sobol(family.dimensions(machine), seed=0).random(DRAWS)
        planned = [one for point in points if (one := _planned(machine, family, request, point)) is not None]
        far = separation.about([plan for _, plan in planned])
        drawn += [(_worth(shares, np.column_stack([d, d])), *one) for one, d in zip(planned, far, strict=True)]
        report(FREE_RUNS * (number + 1) / len(asked))
    best: tuple[float, Proposal] | None = None
    for number, (_, experiment, plan) in enumerate(sorted(drawn, key=lambda each: -each[0])[:FITTED]):
        separations = separation.of_plan(plan)
        worth = _worth(shares, separations)
        if worth > 0.0 and (best is None or worth > best[0]):
            best = worth, Proposal(experiment, tuple(models), separations, plan.rows / machine.sample_rate_Hz)
        report(FREE_RUNS + (1.0 - FREE_RUNS) * (number + 1) / FITTED)
    return None if best is None else best[1]


def _worth(shares: np.ndarray, separations: np.ndarray) -> float:
    """Mean over who may be right, the first set or a rival, of log(1 + d^2)."""
    first, rivals = shares[0], shares[1:]
    logs = np.log1p(separations**2)
    return float(rivals @ (first * logs[:, 0] + rivals * logs[:, 1]) / max(float(rivals @ (first + rivals)), 1e-300))


def _planned(machine: Machine, family: Family, request: Request, point: np.ndarray) -> tuple[Experiment, Plan] | None:
    """None where the machine's limits forbid it."""
    try:
        experiment = family.experiment(machine, request, point)
        return experiment, experiment.plans(machine)[0]
    except ExperimentError:
        return None

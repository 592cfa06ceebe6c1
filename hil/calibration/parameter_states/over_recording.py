"""The filter of parameters as states, run over a recording and its images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.signal import savgol_filter

from controllers.models.swinging_chain import Readings, readings
from hil.calibration.parameter_states.filter import FAR, REFUSED, USED, ParameterStatesFilter
from hil.calibration.parameter_states.filter_model import PoseImage, Randomness, Run, SwingingMachine

SMOOTH_s, ORDER = 0.2, 4
"""The motion that readings are linearised about is a polynomial of this order through the encoders over this span."""

CHUNK = 128
"""Samples linearised at once: most beginnings are in a run's first seconds, and linearise no further."""

MOST_BEGUN = 2
"""Most beginnings for one image; the next image begins anew where these left the estimate out of reach."""

CONTRADICTED = 3
"""Images that agree with the drawing in nothing, and no image that does: the machine is further from its drawing than was said."""

MOST_WIDENED = 3
"""Times that the tolerances are doubled."""

MOST_BEGUN_IN_ALL = 20
"""Where an axis stands still, combinations that nothing shows wander for ever; poses do not depend on them."""


@dataclass
class Estimated:
    """What a run told.

    Attributes
    ----------
    names : tuple of str
        The chain's parameters, then the dynamic ones.
    values, deviations : (images + 1, names) lists of arrays
        Before any image and after each; dynamic parameters as logarithms of ratios to the start.
    used, refused : lists of int
        Images.
    widened : int
        How often the drawing's tolerances were doubled, because no image agreed with it.
    at_s : list of float
        Instants of `poses`.
    poses : list of (source, phantom, rotation)
    covariances : list of (9, 9) arrays
    dynamic : list of (3 m,) arrays
        Dynamic parameters at `at_s`.
    nis : list of float
        Of encoders and sensor, over the degrees of freedom.
    final : ParameterStatesFilter
    """

    names: tuple[str, ...]
    final: ParameterStatesFilter
    values: list[np.ndarray] = field(default_factory=list)
    deviations: list[np.ndarray] = field(default_factory=list)
    used: list[int] = field(default_factory=list)
    refused: list[int] = field(default_factory=list)
    widened: int = 0
    at_s: list[float] = field(default_factory=list)
    poses: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = field(default_factory=list)
    covariances: list[np.ndarray] = field(default_factory=list)
    dynamic: list[np.ndarray] = field(default_factory=list)
    nis: list[float] = field(default_factory=list)

    def keep(self) -> None:
        """Keep the parameters of now."""
        work = self.final
        spots = np.r_[work.fixed, work.dynamic]
        self.values.append(work.x[spots].copy())
        self.deviations.append(np.sqrt(np.diag(work.covariance)[spots]))


def estimate(machine: SwingingMachine, random: Randomness, run: Run, withdrawn: int | None = None, every: int = 32) -> Estimated:
    """Run the filter over a run.

    Parameters
    ----------
    machine : SwingingMachine
        The start.
    random : Randomness
    run : Run
    withdrawn : int, optional
        Images are left out after so many.
    every : int
        Samples from one kept pose to the next.
    """
    images = run.images if withdrawn is None else run.images[:withdrawn]
    result = Estimated((*machine.chain.names, *machine.dynamic_names), ParameterStatesFilter(machine, random, run.encoder[0]))
    result.keep()
    events = sorted([(each.time_s, 0, k) for k, each in enumerate(images)] + [(each.arrives_s, 1, k) for k, each in enumerate(images)])
    way = _Way(result, run, images, events, every)
    number, kept = 0, 0
    while number <= len(events):
        how = way.go(number)
        for _ in range(MOST_BEGUN):
            if how != FAR or way.begun >= MOST_BEGUN_IN_ALL:
                break
            work = result.final
            unsure = work.covariance[work.fixed, work.fixed].copy()
            result.final = ParameterStatesFilter(machine, random, run.encoder[0], work.x[work.fixed].copy(), unsure)
            how = way.again(number)
        if not result.used and len(result.refused) == CONTRADICTED and result.widened < MOST_WIDENED:
            random = replace(random, parameters=2.0 * random.parameters)
            result.widened += 1
            result.final = ParameterStatesFilter(machine, random, run.encoder[0])
            way.begin()
            number = 0
            continue
        if number < len(events) and events[number][1] == 1 and number >= kept:
            result.keep()
            kept = number + 1
        number += 1
    return result


class _Way:
    """A filter on its way through a run: up to an event, exposure or arrival of an image, and again from the start."""

    def __init__(
        self, result: Estimated, run: Run, images: Sequence[PoseImage], events: Sequence[tuple[float, int, int]], every: int
    ) -> None:
        self.result, self.run, self.images, self.events, self.every = result, run, images, events, every
        self.begun, self.row, self.now, self.told_rows = 0, 0, float(run.time_s[0]), 0
        self.effort = np.zeros(run.effort.shape[1])
        period = float(np.median(np.diff(run.time_s)))
        window = max(ORDER + 2, round(SMOOTH_s / period)) | 1
        self.motion = [savgol_filter(run.encoder, window, ORDER, deriv=d, delta=period, axis=0) for d in range(3)]
        self.rows: Readings | None = None
        self.wrong = np.zeros((0, 6))
        self.first = self.stop = 0

    def begin(self) -> None:
        """Go back to the start."""
        self.row, self.now, self.rows = 0, float(self.run.time_s[0]), None
        self.effort = np.zeros_like(self.effort)
        self.result.used.clear()
        self.result.refused.clear()

    def again(self, number: int) -> str:
        """Go from the start to event `number`; return what became of its image."""
        self.begun += 1
        self.begin()
        for earlier in range(number):
            self.go(earlier, is_newest=False)
        return self.go(number)

    def go(self, number: int, is_newest: bool = True) -> str:
        """Go to event `number`, or to the end of the run; return what became of its image."""
        work, run = self.result.final, self.run
        at, is_arrival, image = self.events[number] if number < len(self.events) else (np.inf, 0, -1)
        while self.row < len(run.time_s) and run.time_s[self.row] <= at:
            self._sample()
        if image < 0:
            return USED
        work.predict(at - self.now, self.effort)
        self.now = max(self.now, at)
        if not is_arrival:
            work.exposed(image)
            return USED
        how = work.see(image, self.images[image], is_newest)
        (self.result.refused if how == REFUSED else self.result.used).append(image)
        work.dropped(image)
        return how

    def _sample(self) -> None:
        work, run, row, result = self.result.final, self.run, self.row, self.result
        if self.rows is None or row >= self.stop:
            self.first, self.stop = row, row + CHUNK
            chain = work.machine.chain.with_values(work.about)
            part = slice(self.first, self.stop)
            position, speed, acceleration = (each[part] for each in self.motion)
            self.rows = readings(chain, work.machine.imu, position, speed, acceleration, work.machine.gravity_m_s2)
            self.wrong = work.beyond_first_order(self.rows)
        work.predict(float(run.time_s[row]) - self.now, self.effort)
        self.now = float(run.time_s[row])
        motion = np.concatenate([each[row] for each in self.motion])
        nis = work.sense(run.encoder[row], run.imu[row], self.effort, self.rows, row - self.first, motion, self.wrong[row - self.first])
        self.effort = run.effort[row]
        self.row += 1
        if row < self.told_rows:  # told before this beginning
            return
        self.told_rows = row + 1
        result.nis.append(nis)
        if row % self.every == 0:
            poses, covariance = work.geometry()
            result.at_s.append(self.now)
            result.poses.append(poses)
            result.covariances.append(covariance)
            result.dynamic.append(work.x[work.dynamic].copy())

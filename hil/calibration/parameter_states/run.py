"""The filter of parameters as states, run over a recording and its images."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.signal import savgol_filter

from controllers.models.swinging_chain import readings
from hil.calibration.parameter_states.filter import ParameterStatesFilter
from hil.calibration.parameter_states.model import Randomness, Run, SwingingMachine

SMOOTH_s, ORDER = 0.2, 4
"""The motion that readings are linearised about is a polynomial of this order through the encoders over this span."""

CHUNK = 256
"""Most samples between two linearisations where no image comes."""


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
    work = ParameterStatesFilter(machine, random, run.encoder[0])
    result = Estimated((*machine.chain.names, *machine.dynamic_names), work)
    result.keep()
    period = float(np.median(np.diff(run.time_s)))
    window = max(ORDER + 2, round(SMOOTH_s / period)) | 1
    motion = [savgol_filter(run.encoder, window, ORDER, deriv=d, delta=period, axis=0) for d in range(3)]
    images = run.images if withdrawn is None else run.images[:withdrawn]
    events = sorted([(each.time_s, 0, k) for k, each in enumerate(images)] + [(each.arrives_s, 1, k) for k, each in enumerate(images)])
    now, row, next_event = float(run.time_s[0]), 0, 0
    first, rows, about = 0, None, np.zeros(0)
    effort = np.zeros(machine.axes)
    while row < len(run.time_s):
        event = events[next_event] if next_event < len(events) else (np.inf, 0, -1)
        if event[0] < run.time_s[row]:
            work.predict(event[0] - now, effort)
            now = max(now, event[0])
            next_event += 1
            if event[1] == 0:
                work.exposed(event[2])
                continue
            (result.used if work.see(event[2], images[event[2]]) else result.refused).append(event[2])
            work.dropped(event[2])
            result.keep()
            rows = None
            continue
        if rows is None or row - first >= CHUNK:
            upcoming = next((time for time, kind, _ in events[next_event:] if kind == 1), np.inf)
            first, stop = row, min(row + CHUNK, max(row + 1, int(np.searchsorted(run.time_s, upcoming)) + 1))
            about = work.x[work.fixed].copy()
            chain = machine.chain.with_values(about)
            rows = readings(chain, machine.imu, *(each[first:stop] for each in motion), machine.gravity_m_s2)
        work.predict(float(run.time_s[row]) - now, effort)
        now = float(run.time_s[row])
        base = np.concatenate([*(each[row] for each in motion), about])
        result.nis.append(work.sense(run.encoder[row], run.imu[row], effort, rows, row - first, base))
        effort = run.effort[row]
        if row % every == 0:
            poses, covariance = work.geometry()
            result.at_s.append(now)
            result.poses.append(poses)
            result.covariances.append(covariance)
            result.dynamic.append(work.x[work.dynamic].copy())
        row += 1
    return result

"""Which sweeps show a machine's kinematic parameters: a calibration scan that excites persistently (thesis Sec. 2.4.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controllers.models.flexible_chain import FlexibleChain
from hil.calibration.kinematic.flexible import tolerances
from hil.calibration.kinematic.identify_denavit_hartenberg import free_parameters
from hil.calibration.kinematic.nominal_chain import nominal_chain
from hil.calibration.kinematic.observable import NullCombination, combinations_seen
from hil.errors import UnusableInputError
from hil.experiments import Tour
from hil.machine import Machine

POSE_SIGMA = np.array([0.45e-3, 0.45e-3, 0.5e-3, 0.15e-3, 0.15e-3, 0.15e-3, 0.4e-3, 0.4e-3, 0.02e-3])
"""Of one exposure's nine parameters [m, rad], as the dodecahedron gives them at 2000 photons."""

PLACES = 5
"""Positions of the other axes that sweeps are tried at, over the range allowed."""

MOST_POSES = 2000

GRID = 9
"""Positions an axis at which predicted poses are judged."""


@dataclass(frozen=True)
class Proposal:
    """Sweeps, and what they show.

    Attributes
    ----------
    tour : Tour
    sweeps : int
        Of one axis each; on the way from one to the next images are useful too, but not counted.
    position_sigma_m, rotation_sigma_rad : float
        Rms over all poses of the range, of what the fitted model will predict.
    nominal_sigma_m : float
        The same before any scan, by the drawing's tolerances.
    rank : int
        Combinations that the sweeps show.
    free : int
    null : tuple of NullCombination
    frozen : tuple of str
    """

    tour: Tour
    sweeps: int
    position_sigma_m: float
    rotation_sigma_rad: float
    nominal_sigma_m: float
    rank: int
    free: int
    null: tuple[NullCombination, ...]
    frozen: tuple[str, ...]


@dataclass(frozen=True)
class _Sweep:
    """One axis from end to end, the others standing: exposures at (N, axes)."""

    positions: np.ndarray

    @property
    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        return self.positions[0], self.positions[-1]


def propose_scan(machine: Machine, model: FlexibleChain, sweeps: int, exposures: int, share: float, pace: float) -> Proposal:
    """Propose sweeps of one axis at a time, chosen one after the other so that poses of the whole range are predicted best.

    Parameters
    ----------
    machine : Machine
    model : FlexibleChain
        Nominal.
    sweeps : int
        How many.
    exposures : int
        Images a sweep.
    share : float
        Of every axis's range that sweeps and prediction cover.
    pace : float
        Of the tour.

    Raises
    ------
    UnusableInputError
        An axis without limits.
    """
    axes, ends = _range(machine, model, share)
    scale = tolerances(model)
    judged = model.jacobian(_grid(ends, axes, GRID))[:, 3:] * scale
    candidates = _candidates(ends, axes, exposures)
    information = [_information(model, sweep.positions, scale) for sweep in candidates]
    total = np.eye(len(scale))  # the drawing, at its tolerances
    chosen: list[_Sweep] = []
    before = _predicted(judged, total)[0]
    for _ in range(sweeps):
        best = int(np.argmin([_predicted(judged, total + each)[0] for each in information]))
        chosen.append(candidates[best])
        total = total + information[best]
    rank, null, frozen = shown_by(model, np.concatenate([sweep.positions for sweep in chosen]))
    position, rotation = _predicted(judged, total)
    return Proposal(
        tour=_tour(machine, chosen, axes, pace),
        sweeps=sweeps,
        position_sigma_m=position,
        rotation_sigma_rad=rotation,
        nominal_sigma_m=before,
        rank=rank,
        free=len(model.names) - len(frozen),
        null=null,
        frozen=frozen,
    )


def grid_tour(machine: Machine, step: float, share: float, pace: float, dwell_s: float) -> Tour:
    """Return poses over the range of the axes that carry the panel, at most `step` [rad] apart, row by row, there and back.

    Raises
    ------
    UnusableInputError
        An axis without limits, or more poses than anybody waits for.
    """
    axes, ends = _range(machine, nominal_chain(machine), share)
    lines = {k: np.linspace(ends[k, 0], ends[k, 1], int(np.ceil(np.ptp(ends[k]) / step)) + 1) for k in axes}
    count = int(np.prod([len(line) for line in lines.values()]))
    if count > MOST_POSES:
        raise UnusableInputError(f"a step of {np.degrees(step):g} deg makes {count} poses; at most {MOST_POSES}")
    poses: list[dict[str, float]] = [{}]
    for axis, line in lines.items():
        poses = [
            {**pose, machine.axes[axis]: float(place)} for k, pose in enumerate(poses) for place in (line if k % 2 == 0 else line[::-1])
        ]
    return Tour(tuple(poses), pace, dwell_s)


def _range(machine: Machine, model: FlexibleChain, share: float) -> tuple[list[int], np.ndarray]:
    """Return the axes that carry the panel, and ends (axes, 2) of a share of every axis's range, about its middle."""
    axes = [k for k, row in enumerate(model.driven) if row >= 0]
    limits = np.array([[limit.lower, limit.upper] for limit in machine.limits])
    if not np.isfinite(limits[axes]).all():
        raise UnusableInputError(f"{machine.name}: its file has no limits.AXIS.range_deg; a calibration stays within it")
    ends = np.zeros_like(limits)
    middle = limits[axes].mean(axis=1, keepdims=True)
    ends[axes] = middle + share * (limits[axes] - middle)
    return axes, ends


def shown_by(model: FlexibleChain, positions: np.ndarray) -> tuple[int, tuple[NullCombination, ...], tuple[str, ...]]:
    """Return what exposures at positions (N, axes) show of the parameters: rank, null combinations, and frozen parameters."""
    free = free_parameters(model.chain, model.names, model.angles(positions), ())
    white = (model.jacobian(positions) / POSE_SIGMA[:, None]).reshape(-1, len(model.names))
    _, null = combinations_seen(white[:, free], tolerances(model)[free], [model.names[k] for k in free])
    return len(free) - len(null), null, tuple(name for k, name in enumerate(model.names) if k not in set(free))


def _grid(ends: np.ndarray, axes: list[int], count: int) -> np.ndarray:
    lines = [np.linspace(ends[k, 0], ends[k, 1], count) if k in axes else np.zeros(1) for k in range(len(ends))]
    return np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, len(ends))


def _candidates(ends: np.ndarray, axes: list[int], exposures: int) -> list[_Sweep]:
    result = []
    for axis in axes:
        for place in _grid(ends, [k for k in axes if k != axis], PLACES):
            positions = np.tile(place, (exposures, 1))
            positions[:, axis] = np.linspace(ends[axis, 0], ends[axis, 1], exposures)
            result.append(_Sweep(positions))
    return result


def _information(model: FlexibleChain, positions: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Return the information (p, p) on the parameters in units of their tolerance."""
    white = (model.jacobian(positions) / POSE_SIGMA[:, None]).reshape(-1, len(scale)) * scale
    gram: np.ndarray = white.T @ white
    return gram


def _predicted(judged: np.ndarray, information: np.ndarray) -> tuple[float, float]:
    """Return the rms standard deviation of the poses' position [m] and rotation [rad] with that information."""
    half = np.linalg.solve(np.linalg.cholesky(information), judged.reshape(-1, len(information)).T)
    variance = np.sum(half**2, axis=0).reshape(-1, 6)
    return float(np.sqrt(variance[:, :3].sum(axis=1).mean())), float(np.sqrt(variance[:, 3:].sum(axis=1).mean()))


def _tour(machine: Machine, sweeps: list[_Sweep], axes: list[int], pace: float) -> Tour:
    """Run every sweep from its nearer end."""
    stops = []
    here = np.zeros(len(machine.axes))
    for sweep in sweeps:
        ends = sorted(sweep.ends, key=lambda end: float(np.linalg.norm(end - here)))
        stops += [{machine.axes[k]: float(end[k]) for k in axes} for end in ends]
        here = ends[1]
    return Tour(tuple(stops), pace)

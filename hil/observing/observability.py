"""Which of the observer's states the sensors determine, and which not: the rank condition (5.14), in numbers.

The rank in (5.14) does not say how well. So the information from a second of measurements is compared with the prior: a direction in which
it adds less than the prior holds is not observed, whatever the rank says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from controllers.errors import DesignError
from controllers.observers.modal_observer import ModalObserver

SECONDS = 1.0
"""Standstill over which information is gathered: many periods of every mode."""

NAMED_SHARE = 0.3
"""A state is named in a direction when it has this share of the largest one's part."""


@dataclass(frozen=True)
class Observability:
    """Which states are observed.

    Attributes
    ----------
    state_names : of all states.
    told : (states,) share of each state's prior variance that the measurements remove: 1 observed, 0 not at all.
    blind : for each direction that is not observed, the names of the states in it, the largest part first.
    rank : of (5.14), states scaled by their prior.
    """

    state_names: tuple[str, ...]
    told: np.ndarray
    blind: tuple[tuple[str, ...], ...]
    rank: int

    @property
    def lines(self) -> list[str]:
        """Return the finding in words."""
        count = len(self.state_names)
        text = [f"{count - len(self.blind)} of {count} directions of the state are observed within {SECONDS:g} s at rest"]
        return text + [f"not observed: {' with '.join(names)}" for names in self.blind]


def observability(observer: ModalObserver, poses: Sequence[np.ndarray], missing: Sequence[str] = ()) -> Observability:
    """Return what is observed from standstill at one pose or more.

    Parameters
    ----------
    poses : sequence of (n_axes,) arrays
        Biases are the same in all of them; everything else has to be told anew in each, so the last pose's is judged.
    missing : sequence of str
        Channels taken for absent.

    Raises
    ------
    DesignError
        A channel that the observer does not know.
    """
    channels = observer.model.channels()
    for name in missing:
        if name not in channels:
            raise DesignError(f"missing = {name}: the observer looks at {', '.join(channels)}")
    kept = np.array([name not in missing for name in channels])
    names = observer.state_names
    prior = np.maximum(observer.initial_std, 1e-30)
    constant = np.array([name.startswith(("bias_", "offset_", "log_frequency")) for name in names])
    carried = np.zeros((len(names), len(names)))
    rank = 0
    for index, pose in enumerate(poses):
        F, H = observer.linearised(np.asarray(pose, float))
        weighted = H[kept] / observer.noise.measurement[kept][:, None]
        information, rank = _gathered(F, weighted, prior, round(SECONDS * observer.model.sample_rate_Hz))
        if index < len(poses) - 1:
            carried[np.ix_(constant, constant)] += _left_for(information, constant)
    total = information + carried
    values, vectors = np.linalg.eigh(total)
    posterior = np.linalg.inv(np.eye(len(names)) + total)
    blind = []
    for value, vector in zip(values, vectors.T, strict=True):
        if value < 1.0:
            part = np.abs(vector)
            order = np.argsort(part)[::-1]
            blind.append(tuple(names[i] for i in order if part[i] >= NAMED_SHARE * part.max()))
    return Observability(tuple(names), 1.0 - np.clip(np.diag(posterior), 0.0, 1.0), tuple(blind), rank)


def _gathered(F: np.ndarray, weighted: np.ndarray, prior: np.ndarray, samples: int) -> tuple[np.ndarray, int]:
    """Return the information (states, states) of so many samples, and the rank of (5.14), both scaled by the prior."""
    rows = weighted * prior
    step = F * prior / prior[:, None]
    information = np.zeros_like(step)
    stacked = []
    for k in range(samples):
        information += rows.T @ rows
        if k < len(prior):
            stacked.append(rows)
        rows = rows @ step
    return information, int(np.linalg.matrix_rank(np.vstack(stacked)))


def _left_for(information: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Return the information on some states when the others are free, known by no more than the prior."""
    others = ~kept
    inner = information[np.ix_(others, others)] + np.eye(int(others.sum()))
    cross = information[np.ix_(kept, others)]
    remaining: np.ndarray = information[np.ix_(kept, kept)] - cross @ np.linalg.solve(inner, cross.T)
    return remaining

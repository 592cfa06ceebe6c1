"""Parametric LPV modal model, Sec. 5.4: poles and numerators as smooth functions of a scheduling parameter, from responses over poses.

Every mode in the band has a denominator with coefficients that are polynomials of the pose. Poles below and above the band represent the
effect of the dynamics there within the band. All poses are fitted together, weighted by the covariances (`all_poses`). The number of modes,
of poles outside the band and every polynomial's order are chosen (`choice`). (5.31) and (5.32) are used with the first rows [0 I] and [C_m
0].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import legendre
from scipy import special

from hil.errors import IdentificationError
from hil.identification.modal.all_poses import JointFit, JointProblem
from hil.identification.modal.choice import HIGHEST_ORDER, choose_blocks, mode_blocks, modes_along, with_better_form, with_chosen_orders
from hil.identification.modal.pole_blocks import Block
from hil.identification.result import FrequencyResponse

if TYPE_CHECKING:
    import control


@dataclass(frozen=True)
class ModalFrfModel:
    """Omega(theta), Z(theta), B_m(theta), C_m(theta) of (5.35), each mode's product of the last two as its numerator.

    Attributes
    ----------
    fit : polynomials of the pose scaled to -1 ... 1.
    pose_range : lowest and highest pose fitted. direction : which scheduling parameter of the responses.
    poses : (n,) fitted. alone : (n, K, 2) natural frequency [Hz] and damping ratio of every mode, from each pose alone.
    """

    fit: JointFit
    pose_range: tuple[float, float]
    direction: int
    poses: np.ndarray
    alone: np.ndarray
    output_names: tuple[str, ...]
    input_names: tuple[str, ...]
    sample_rate_Hz: float

    def modes(self, pose: float, probability: float = 0.95) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return natural frequencies [Hz] and damping ratios (K,) of the modes in the band, and half widths of their intervals."""
        x = self._scaled(pose)
        factor = special.ndtri(0.5 + probability / 2)
        found, at = [], 0
        for block in self.fit.blocks:
            size = sum(len(c) for c in block.coefficients)
            if block.is_mode:
                over_poses = np.zeros((2, size))
                split = len(block.coefficients[0])
                over_poses[0, :split] = legendre.legvander(x, split - 1)[0]
                over_poses[1, split:] = legendre.legvander(x, size - split - 1)[0]
                covariance = over_poses @ self.fit.pole_covariance[at : at + size, at : at + size] @ over_poses.T
                found.append(_mode(block, block.values(x)[0], covariance))
            at += size
        values = np.array(found).reshape(-1, 4)
        return values[:, 0], values[:, 1], factor * values[:, 2], factor * values[:, 3]

    def state_space(self, pose: float) -> control.StateSpace:
        """Return the continuous model from the applied effort to the outputs.

        A mode takes two states, a pole outside the band one per input.
        """
        import control  # takes half a second to load, and only this needs it

        numerators = self._numerators(pose)
        n_u = self.shape[1]
        blocks_A, blocks_B, blocks_C, at = [], [], [], 0
        for block, c in zip(self.fit.blocks, self._monic(pose), strict=True):
            n = block.order
            companion = np.zeros((n, n))
            companion[np.arange(n - 1), np.arange(1, n)] = 1.0
            companion[-1] = -c
            powers, divisor = block.numerator_scale(block.values(self._scaled(pose)))
            N = np.moveaxis(numerators[..., at : at + n] * (powers / divisor[0]), 2, 1)  # (n_y, n, n_u)
            left, b = _one_direction(N) if block.is_mode else (N, np.eye(n_u))
            for r in range(len(b)):
                blocks_A.append(companion)
                blocks_B.append(np.vstack((np.zeros((n - 1, n_u)), b[r])))
                blocks_C.append(left[:, :, r])
            at += n
        A = np.zeros((sum(map(len, blocks_A)),) * 2)
        at = 0
        for companion in blocks_A:
            A[at : at + len(companion), at : at + len(companion)] = companion
            at += len(companion)
        D = numerators[..., -1]
        return control.ss(A, np.vstack(blocks_B), np.hstack(blocks_C), D, inputs=list(self.input_names), outputs=list(self.output_names))

    def response(self, pose: float, frequencies_Hz: np.ndarray) -> np.ndarray:
        """Return the sampled response from command to outputs, including delay of one tick and hold: (L, n_y, n_u)."""
        x = self._scaled(pose)
        parts = [block.responses(block.values(x)[0], frequencies_Hz, self.sample_rate_Hz) for block in self.fit.blocks]
        tick = np.exp(-2j * np.pi * frequencies_Hz / self.sample_rate_Hz)
        G: np.ndarray = np.einsum("ls,ijs->lij", np.concatenate((*parts, tick[:, None]), axis=1), self._numerators(pose))
        return G

    def is_stable(self, pose: float) -> bool:
        """Tell whether every pole of `state_space` is damped.

        The data only determine the effect within the band of poles outside it.
        """
        roots = [np.roots(np.concatenate(([1.0], c[::-1]))) for c in self._monic(pose)]
        return bool(np.all(np.concatenate(roots).real < 0.0))

    def passive_modes(self, pose: float) -> np.ndarray:
        """Tell whether each mode's collocated numerators are not negative beyond their 95 % intervals.

        Returns (K, pairs of one axis's position and command). Effort and speed at the same place exchange power with the machine one way
        only, so every mode's numerator is c b >= 0 there.
        """
        x, n_u = self._scaled(pose), self.shape[1]
        first = np.cumsum([0] + [block.order for block in self.fit.blocks])[:-1]
        at = [start for start, block in zip(first, self.fit.blocks, strict=True) if block.is_mode]
        collocated = [
            i * n_u + j
            for i, output in enumerate(self.output_names)
            for j, source in enumerate(self.input_names)
            if output.startswith("position_") and output.removeprefix("position_") == source.partition("_")[2]
        ]
        passive = np.empty((len(at), len(collocated)), bool)
        for p, e in enumerate(collocated):
            polynomials = self.fit.numerators[e]
            over_poses = legendre.legvander(x, len(polynomials) - 1)[0]
            for k, s in enumerate(at):
                places = np.arange(len(polynomials)) * polynomials.shape[1] + s
                variance = over_poses @ self.fit.numerator_covariance[e][np.ix_(places, places)] @ over_poses
                passive[k, p] = over_poses @ polynomials[:, s] >= -special.ndtri(0.975) * np.sqrt(variance)
        return passive

    @property
    def shape(self) -> tuple[int, int]:
        """n_y, n_u."""
        return len(self.output_names), len(self.input_names)

    def _scaled(self, pose: float) -> np.ndarray:
        low, high = self.pose_range
        x = 2.0 * (pose - low) / (high - low) - 1.0
        if abs(x) > 1.0 + 1e-9:
            raise IdentificationError(f"pose {pose:g} is outside {low:g} to {high:g}, over which the model was fitted")
        return np.array([x])

    def _numerators(self, pose: float) -> np.ndarray:
        """Return the scaled numerators, D last: (n_y, n_u, S + 1)."""
        x = self._scaled(pose)
        return np.stack([legendre.legvander(x, len(n) - 1)[0] @ n for n in self.fit.numerators]).reshape(*self.shape, -1)

    def _monic(self, pose: float) -> list[np.ndarray]:
        x = self._scaled(pose)
        return [block.monic(block.values(x))[0][0] for block in self.fit.blocks]


def fit_modal_model(responses: Sequence[FrequencyResponse], direction: int) -> ModalFrfModel:
    """Fit the model to responses at poses along one scheduling parameter.

    The number of modes and every polynomial's order are chosen from the data.

    Parameters
    ----------
    responses : at the same lines, with independent errors from line to line for the intervals to hold: BLA or robust local methods.
    direction : column of the poses that varies.

    Raises
    ------
    IdentificationError
        Fewer than three poses, different lines, too few lines, no mode in the band.
    """
    if len(responses) < 3:
        raise IdentificationError(f"{len(responses)} poses: a model over the pose takes three or more")
    if any(not np.array_equal(response.lines, responses[0].lines) for response in responses):
        raise IdentificationError("the poses' responses are at different lines: a model over the pose takes the same at every pose")
    ordered = sorted(responses, key=lambda response: response.pose[direction])
    poses = np.array([response.pose[direction] for response in ordered])
    x = 2.0 * (poses - poses[0]) / (poses[-1] - poses[0]) - 1.0
    alone, modes = modes_along(ordered)
    if not modes.any():
        raise IdentificationError(
            f"no mode between {ordered[0].frequencies_Hz[0]:g} and {ordered[0].frequencies_Hz[-1]:g} Hz is seen at every pose"
        )
    highest = min(HIGHEST_ORDER, len(poses) - 2)
    problem = JointProblem(ordered, x)
    middle = 2 * np.pi * np.sqrt(ordered[0].frequencies_Hz[0] * ordered[0].frequencies_Hz[-1])
    outside = np.sqrt(np.median([np.abs(fit.a0) for fit in alone], axis=0))[~modes]
    guess = (min(int(np.sum(outside < middle)), 1), min(int(np.sum(outside >= middle)), 1))
    chosen = choose_blocks(problem, mode_blocks(alone, modes, x, highest), guess, highest)
    chosen = with_better_form(problem, chosen, mode_blocks(alone, modes, x, highest, flexible=False))
    rising = np.flatnonzero(modes)[np.argsort([np.mean(np.log([fit.a0[k] for fit in alone])) for k in np.flatnonzero(modes)])]
    first = ordered[0]
    return ModalFrfModel(
        fit=with_chosen_orders(problem, chosen, highest),
        pose_range=(float(poses[0]), float(poses[-1])),
        direction=direction,
        poses=poses,
        alone=np.array([[(np.sqrt(f.a0[k]) / (2 * np.pi), f.a1[k] / (2 * np.sqrt(f.a0[k]))) for k in rising] for f in alone]),
        output_names=first.output_names,
        input_names=first.input_names,
        sample_rate_Hz=first.sample_rate_Hz,
    )


def _mode(block: Block, values: np.ndarray, covariance: np.ndarray) -> tuple[float, float, float, float]:
    """Return a mode's natural frequency [Hz], damping ratio and their standard deviations from its coefficients.

    The damping ratio is zeta = other / (2 root of square).
    """
    at, power = (1, -0.5) if block.flexible else (0, 0.5)
    square, other = values[at], values[1 - at]
    frequency, ratio = block.scale * square**power / (2 * np.pi), other / (2 * np.sqrt(square))
    slope = np.zeros(2)
    slope[at], slope[1 - at] = -ratio / (2 * square), 1.0 / (2 * np.sqrt(square))
    deviation = np.sqrt(max(covariance[at, at], 0.0)) * abs(power) * frequency / square
    return float(frequency), float(ratio), float(deviation), float(np.sqrt(max(slope @ covariance @ slope, 0.0)))


def _one_direction(N: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return C (n_y, 2, 1) and B (1, n_u) of a mode's numerators (n_y, 2, n_u): it is driven in one direction."""
    scale = np.linalg.norm(N[:, 0]) / max(float(np.linalg.norm(N[:, 1])), np.finfo(float).tiny)
    stacked = np.concatenate((N[:, 0], N[:, 1] * scale))
    left, singular, right = np.linalg.svd(stacked, full_matrices=False)
    C = left[:, :1] * singular[0]
    return np.stack((C[: len(N)], C[len(N) :] / scale), axis=1), right[:1]

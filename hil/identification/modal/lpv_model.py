"""Parametric LPV modal model, Sec. 5.4: poles and numerators as smooth functions of one or two scheduling parameters, over poses.

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
from scipy import special

from hil.errors import IdentificationError
from hil.identification.modal.all_poses import JointFit, JointProblem
from hil.identification.modal.choice import choose_blocks, highest_order, mode_blocks, modes_over, with_better_form, with_chosen_orders
from hil.identification.modal.pole_blocks import Block
from hil.identification.modal.pose_basis import over_poses
from hil.identification.result import FrequencyResponse

if TYPE_CHECKING:
    import control


Pose = float | Sequence[float]
"""Of one scheduling parameter, or of two [rad or m]."""

FEWEST, NUMBER = {1: 3, 2: 6}, {3: "three", 6: "six"}
"""Poses that a model takes, by its axes: one more than a line has terms, or twice as many as a plane; see `highest_order`, too."""


@dataclass(frozen=True)
class ModalFrfModel:
    """Omega(theta), Z(theta), B_m(theta), C_m(theta) of (5.35), each mode's product of the last two as its numerator.

    Attributes
    ----------
    fit : polynomials of the pose scaled to -1 ... 1.
    pose_range : (axes, 2) lowest and highest pose fitted, of each scheduling parameter. directions : which of the responses' they are.
    poses : (n, axes) fitted. alone : (n, K, 2) natural frequency [Hz] and damping ratio of every mode, from each pose alone.
    """

    fit: JointFit
    pose_range: np.ndarray
    directions: tuple[int, ...]
    poses: np.ndarray
    alone: np.ndarray
    output_names: tuple[str, ...]
    input_names: tuple[str, ...]
    sample_rate_Hz: float

    def modes(self, pose: Pose, probability: float = 0.95) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return natural frequencies [Hz] and damping ratios (K,) of the modes in the band, and half widths of their intervals."""
        x = self._scaled(pose)
        factor = special.ndtri(0.5 + probability / 2)
        found, at = [], 0
        for block in self.fit.blocks:
            size = sum(len(c) for c in block.coefficients)
            if block.is_mode:
                products = np.zeros((2, size))
                split = len(block.coefficients[0])
                products[0, :split] = over_poses(x, split)[0]
                products[1, split:] = over_poses(x, size - split)[0]
                covariance = products @ self.fit.pole_covariance[at : at + size, at : at + size] @ products.T
                found.append(_mode(block, block.values(x)[0], covariance))
            at += size
        values = np.array(found).reshape(-1, 4)
        return values[:, 0], values[:, 1], factor * values[:, 2], factor * values[:, 3]

    def state_space(self, pose: Pose) -> control.StateSpace:
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

    def response(self, pose: Pose, frequencies_Hz: np.ndarray) -> np.ndarray:
        """Return the sampled response from command to outputs, including delay of one tick and hold: (L, n_y, n_u)."""
        x = self._scaled(pose)
        parts = [block.responses(block.values(x)[0], frequencies_Hz, self.sample_rate_Hz) for block in self.fit.blocks]
        tick = np.exp(-2j * np.pi * frequencies_Hz / self.sample_rate_Hz)
        G: np.ndarray = np.einsum("ls,ijs->lij", np.concatenate((*parts, tick[:, None]), axis=1), self._numerators(pose))
        return G

    def is_stable(self, pose: Pose) -> bool:
        """Tell whether every pole of `state_space` is damped.

        The data only determine the effect within the band of poles outside it.
        """
        roots = [np.roots(np.concatenate(([1.0], c[::-1]))) for c in self._monic(pose)]
        return bool(np.all(np.concatenate(roots).real < 0.0))

    def passive_modes(self, pose: Pose) -> np.ndarray:
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
            products = over_poses(x, len(polynomials))[0]
            for k, s in enumerate(at):
                places = np.arange(len(polynomials)) * polynomials.shape[1] + s
                variance = products @ self.fit.numerator_covariance[e][np.ix_(places, places)] @ products
                passive[k, p] = products @ polynomials[:, s] >= -special.ndtri(0.975) * np.sqrt(variance)
        return passive

    @property
    def shape(self) -> tuple[int, int]:
        """n_y, n_u."""
        return len(self.output_names), len(self.input_names)

    def _scaled(self, pose: Pose) -> np.ndarray:
        """Return a pose as the polynomials take it (1, axes)."""
        values = np.atleast_1d(np.asarray(pose, dtype=float))
        if values.shape != (len(self.pose_range),):
            raise IdentificationError(f"pose {values.tolist()}: {len(values)} numbers, and the model is over {len(self.pose_range)}")
        x = _scaled(values[None], self.pose_range)
        for value, (low, high), place in zip(values, self.pose_range, x[0], strict=True):
            if abs(place) > 1.0 + 1e-9:
                raise IdentificationError(f"pose {value:g} is outside {low:g} to {high:g}, over which the model was fitted")
        return x

    def _numerators(self, pose: Pose) -> np.ndarray:
        """Return the scaled numerators, D last: (n_y, n_u, S + 1)."""
        x = self._scaled(pose)
        return np.stack([over_poses(x, len(n))[0] @ n for n in self.fit.numerators]).reshape(*self.shape, -1)

    def _monic(self, pose: Pose) -> list[np.ndarray]:
        x = self._scaled(pose)
        return [block.monic(block.values(x))[0][0] for block in self.fit.blocks]


def fit_modal_model(responses: Sequence[FrequencyResponse], directions: int | Sequence[int]) -> ModalFrfModel:
    """Fit the model to responses at poses along one scheduling parameter, or all over two.

    The number of modes and every polynomial's order are chosen from the data.

    Parameters
    ----------
    responses : at the same lines, with independent errors from line to line for the intervals to hold: BLA or robust local methods.
    directions : column of the poses that varies, or both. The model then holds in the box that the poses span, best among them.

    Raises
    ------
    IdentificationError
        Fewer than three poses, or than six over two axes; two responses of one pose; different lines, too few lines, no mode in the band.
    """
    columns = (directions,) if isinstance(directions, int | np.integer) else tuple(directions)
    least = FEWEST.get(len(columns), 0)
    if len(responses) < least:
        over = "the pose" if len(columns) == 1 else "two axes"
        raise IdentificationError(f"{len(responses)} poses: a model over {over} takes {NUMBER[least]} or more")
    if any(not np.array_equal(response.lines, responses[0].lines) for response in responses):
        raise IdentificationError("the poses' responses are at different lines: a model over the pose takes the same at every pose")
    ordered = sorted(responses, key=lambda response: [response.pose[column] for column in columns])
    poses = np.array([[response.pose[column] for column in columns] for response in ordered])
    if len(np.unique(poses, axis=0)) < len(poses):
        raise IdentificationError("two responses are of one pose: give one of each")
    pose_range = np.stack((poses.min(axis=0), poses.max(axis=0)), axis=1)
    x = _scaled(poses, pose_range)
    highest = highest_order(x)
    alone, modes = modes_over(ordered, x)
    if not modes.any():
        raise IdentificationError(
            f"no mode between {ordered[0].frequencies_Hz[0]:g} and {ordered[0].frequencies_Hz[-1]:g} Hz is seen at every pose"
        )
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
        pose_range=pose_range,
        directions=columns,
        poses=poses,
        alone=np.array([[(np.sqrt(f.a0[k]) / (2 * np.pi), f.a1[k] / (2 * np.sqrt(f.a0[k]))) for k in rising] for f in alone]),
        output_names=first.output_names,
        input_names=first.input_names,
        sample_rate_Hz=first.sample_rate_Hz,
    )


def _scaled(poses: np.ndarray, pose_range: np.ndarray) -> np.ndarray:
    """Return poses (n, axes) with each axis scaled to -1 ... 1 over its range (axes, 2)."""
    scaled: np.ndarray = 2.0 * (poses - pose_range[:, 0]) / (pose_range[:, 1] - pose_range[:, 0]) - 1.0
    return scaled


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

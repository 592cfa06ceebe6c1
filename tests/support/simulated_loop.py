"""A small closed-loop machine simulated with NumPy alone: two inputs, three outputs, two of them fed back.

    u = w - K F(z) y_fb,   y = G u + disturbance,   command k applied one tick later and held, F a first-order lag

It shares no code with the emulator or the estimators; its frequency responses come from its matrices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy import linalg

SAMPLE_RATE_HZ = 64.0


@dataclass(frozen=True)
class Loop:
    """State-space matrices of the plant G, gains and lag of the feedback K F, and coefficients of its cubic and square terms."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    gains: np.ndarray  # (2, 3) static feedback u = w - gains y
    cubic: float = 0.0  # of the second fed-back output, added to the first input's effort
    square: float = 0.0
    lag: float = 0.0  # pole of the feedback's filter: a controller whose response changes over a local window


def two_mode_loop(
    frequencies_Hz: tuple[float, float] = (3.0, 7.0),
    damping: tuple[float, float] = (0.03, 0.02),
    cubic: float = 0.0,
    square: float = 0.0,
    feedback: float = 1.0,
    lag: float = 0.0,
) -> Loop:
    """Two lightly damped modes; outputs: a non-collocated acceleration and two collocated positions."""
    omega, zeta = 2 * np.pi * np.array(frequencies_Hz), np.array(damping)
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.diag(omega**2), -np.diag(2 * zeta * omega)]])
    modal_input = np.array([[1.0, 0.4], [-0.3, 0.9]]) * 300.0
    B = np.vstack((np.zeros((2, 2)), modal_input))
    positions = np.hstack((np.array([[1.0, 0.3], [0.4, 1.0]]), np.zeros((2, 2))))
    acceleration_row = np.array([0.02, -0.05])
    C = np.vstack((acceleration_row @ A[2:], positions))
    D = np.vstack((acceleration_row @ B[2:], np.zeros((2, 2))))
    discrete = linalg.expm(np.block([[A, B], [np.zeros((2, 6))]]) / SAMPLE_RATE_HZ)
    Ad, Bd = discrete[:4, :4], discrete[:4, 4:]
    # the command waits one tick: augment the state with the held command
    A1 = np.block([[Ad, Bd], [np.zeros((2, 6))]])
    B1 = np.vstack((np.zeros((4, 2)), np.eye(2)))
    C1, D1 = np.hstack((C, D)), np.zeros((3, 2))
    gains = feedback * np.array([[0.0, 0.02, 0.0], [0.0, 0.0, 0.03]])
    return Loop(A1, B1, C1, D1, gains, cubic, square, lag)


def plant_response(loop: Loop, frequencies_Hz: np.ndarray) -> np.ndarray:
    """(L, 3, 2) of the linear part."""
    z = np.exp(2j * np.pi * frequencies_Hz / SAMPLE_RATE_HZ)
    eye = np.eye(len(loop.A))
    return np.stack([loop.C @ np.linalg.solve(value * eye - loop.A, loop.B) + loop.D for value in z])


def simulate(loop: Loop, excitation: np.ndarray, noise: np.ndarray, initial: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Outputs (T, 3) and commands (T, 2) for an excitation (T, 2) and measurement noise (T, 3) that is fed back with the outputs."""
    x = np.zeros(len(loop.A)) if initial is None else initial.astype(float)
    return _march(loop.A, loop.B, loop.C, loop.gains, loop.cubic, loop.square, loop.lag, excitation, noise, x)


@njit
def _march(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, gains: np.ndarray, cubic: float, square: float, lag: float,
    excitation: np.ndarray, noise: np.ndarray, x: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    y, u = np.empty(noise.shape), np.empty(excitation.shape)
    filtered = np.zeros(noise.shape[1])
    for k in range(len(excitation)):
        clean = C @ x
        y[k] = clean + noise[k]
        filtered = lag * filtered + (1.0 - lag) * y[k]
        u[k] = excitation[k] - gains @ filtered
        effort = u[k].copy()
        effort[0] -= cubic * clean[2] ** 3 + square * clean[2] ** 2
        x = A @ x + B @ effort
    return y, u


def orthogonal_multisine(rng: np.random.Generator, period: int, lines: np.ndarray, amplitude: float = 1.0) -> np.ndarray:
    """(2 experiments, period, 2 inputs): full random orthogonal multisine, W = D_W T D_phi with T = [[1, 1], [1, -1]]."""
    spectrum = np.zeros((2, period // 2 + 1, 2), complex)
    input_phase, experiment_phase = rng.uniform(0, 2 * np.pi, (2, len(lines), 2))
    hadamard = np.array([[1, 1], [1, -1]])
    for e in range(2):
        for i in range(2):
            spectrum[e, lines, i] = amplitude * hadamard[i, e] * np.exp(1j * (input_phase[:, i] + experiment_phase[:, e]))
    return np.fft.irfft(spectrum, period, axis=1) * period / 2


def experiment(
    loop: Loop,
    rng: np.random.Generator,
    *,
    realisations: int,
    periods: int,
    settle_periods: int = 0,
    period: int = 256,
    lines: np.ndarray,
    noise: tuple[float, float, float] = (0.0, 0.0, 0.0),
    excitations: np.ndarray | None = None,
    experiments: int = 2,
) -> dict[str, np.ndarray]:
    """Arrays (M, E, T, channels) `outputs`, `inputs`, `excitation`. `excitations` (M, E, period, 2) repeats given realisations."""
    if excitations is None:
        excitations = np.stack([orthogonal_multisine(rng, period, lines) for _ in range(realisations)])[:, :experiments]
    M, E = excitations.shape[:2]
    total = (settle_periods + periods) * period
    y, u = np.empty((M, E, total, 3)), np.empty((M, E, total, 2))
    w = np.tile(excitations, (1, 1, settle_periods + periods, 1))
    for m in range(M):
        for e in range(E):
            y[m, e], u[m, e] = simulate(loop, w[m, e], rng.standard_normal((total, 3)) * noise)
    return {"outputs": y, "inputs": u, "excitation": w}

"""Disturbances of a narrow band: a fan, the mains, a drive's own hum, which wander in phase and differ from repeat to repeat."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.ndimage

from hil.diagnosis.residuals.whitening import Linearised, Whitening
from virtual_bus.effects.law import SMOOTHED

DRAWS = 4
"""Of white innovations, whose spectra show what noise alone makes of waves: with the lines averaged, to a tenth."""
AVERAGED = 5
"""Lines that a tone fills at first."""


@dataclass(frozen=True, eq=False)
class Tones:
    """Efforts of a narrow band on some joints: a phasor that turns with the tone, driven by white noise.

    Attributes
    ----------
    joints : (a,) int array
    sizes : (a,) array
        Standard deviations [Nm or N].
    frequencies_Hz, widths_Hz : (a,) arrays
        Middle of the band, and half its width at half the power.
    """

    joints: np.ndarray
    sizes: np.ndarray
    frequencies_Hz: np.ndarray
    widths_Hz: np.ndarray

    @property
    def numbers(self) -> int:
        """How many there are."""
        return len(self.sizes) + len(self.frequencies_Hz) + len(self.widths_Hz)

    def times(self, factors: np.ndarray) -> Tones:
        """Return the same with other sizes; factors (n,) of all joints."""
        return replace(self, sizes=self.sizes * factors[self.joints])

    def added_to(self, lin: Linearised, joints: int, period_s: float) -> Linearised:
        """Return the filter's matrices with two further states for each tone, its phasor; the first is an effort as a disturbance is."""
        size, count = lin.transition.shape[1], len(self.joints)
        more = 2 * count
        transition = np.pad(lin.transition, ((0, 0), (0, more), (0, more)))
        observation = np.pad(lin.observation, ((0, 0), (0, 0), (0, more)))
        process, start = np.pad(lin.process, (0, more)), np.pad(lin.start, (0, more))
        left = np.exp(-2.0 * np.pi * self.widths_Hz * period_s)
        turned = 2.0 * np.pi * self.frequencies_Hz * period_s
        moved = np.r_[0 : 2 * joints, 3 * joints : size]
        for i, joint in enumerate(self.joints):
            here, like = size + 2 * i, 2 * joints + joint
            transition[:, moved, here] = lin.transition[:, moved, like]
            observation[:, :, here] = lin.observation[:, :, like]
            cosine, sine = left[i] * np.cos(turned[i]), left[i] * np.sin(turned[i])
            transition[:, here : here + 2, here : here + 2] = [[cosine, -sine], [sine, cosine]]
            process[here : here + 2] = self.sizes[i] ** 2 * (1.0 - left[i] ** 2)
            start[here : here + 2] = self.sizes[i] ** 2
        efforts = (np.pad(each, ((0, 0), (0, more), (0, 0))) for each in (lin.of_effort, lin.of_rise))
        of_effort, of_rise = efforts
        return replace(
            lin, transition=transition, of_effort=of_effort, of_rise=of_rise, observation=observation, process=process, start=start
        )


def tones_in(
    innovations: Sequence[tuple[Whitening, np.ndarray]], joints: Sequence[int], sizes: np.ndarray, period_s: float
) -> Tones | None:
    """Return the likely tones on some joints, by what innovations (N, m) of noise alone ask for; None where no line stands out.

    Parameters
    ----------
    innovations : sequence of (Whitening, (N, m) array)
        Of recordings of one length.
    joints : sequence of int
    sizes : (n,) array
        At first, on all joints.
    """
    rng = np.random.default_rng(0)
    rows = min(len(each) for _, each in innovations)
    asked, noise = np.zeros((2, rows // 2 + 1, len(sizes)))
    for filtered, each in innovations:
        asked += np.abs(np.fft.rfft(filtered.scores(each)[:rows], axis=0)) ** 2
        for _ in range(DRAWS):
            white = filtered.scores(rng.normal(size=each.shape))[:rows]
            noise += np.abs(np.fft.rfft(white, axis=0)) ** 2 / DRAWS
    noise = scipy.ndimage.uniform_filter1d(noise, SMOOTHED, axis=0, mode="nearest")
    ratio = scipy.ndimage.uniform_filter1d(asked, AVERAGED, axis=0, mode="nearest") / np.maximum(noise, 1e-300)
    ratio[:AVERAGED] = 0.0  # slow disturbances are modelled
    found = []
    for joint in joints:
        line = int(np.argmax(ratio[:, joint]))
        freedom = AVERAGED * len(innovations)
        if freedom * (ratio[line, joint] - 1.0 - np.log(max(ratio[line, joint], 1e-300))) > 2.0 * np.log(rows):  # Chernoff's bound: chance
            found.append((joint, line / (rows * period_s)))
    if not found:
        return None
    places = np.array([joint for joint, _ in found])
    frequencies = np.array([frequency for _, frequency in found])
    widths = np.full(len(places), 0.5 * AVERAGED / (rows * period_s))
    return Tones(places, sizes[places], frequencies, widths)

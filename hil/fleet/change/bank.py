"""One night after another: each machine's filter, and the bank of changes that are tried at every earlier night.

The state of a machine and parameter is (a, g, w): its own level, how much more or less than the fleet it follows what is common, and the
scatter that it carries. With the fleet's common part c of a night, u = a + c + g s + w + noise, where s says how far a machine may go its
own way: as far as its parameters y each follow what is common by a factor of their own, s_j^2 = sum_k (adjustment_jk c(y)_k)^2. A Kalman
filter predicts u; what it errs by, cut at `CUT` deviations (Huber 1965, Ann. Math. Stat. 36(6), Sec. 2), updates the state and is
compared with what a step or a growth from each earlier night would leave of it (Willsky, Jones 1976, IEEE Trans. Autom. Control 21(1),
eqs. (20) to (24)).
"""

from __future__ import annotations

import numpy as np
from scipy.stats import norm

from hil.fleet.change.comparing import LEAST_INFORMATION, compare
from hil.fleet.change.scatter_model import FEWEST, MEDIAN_OF_NORMAL, MEDIAN_VARIANCE, FleetModel

CUT = 2.5
"""Deviations: what a night can say at most. With thresholds near 5.5 at least five nights must agree before anything is said, so that a
bad weekend, or a bad machine-file for some days, does not alarm; of Gaussian noise the cut loses 2 % of the information."""

KEPT_OF_CUT = float(1.0 - 2.0 * norm.sf(CUT) - 2.0 * CUT * norm.pdf(CUT) + 2.0 * CUT**2 * norm.sf(CUT))  # variance of a cut normal number

FOLLOWS = 0.5
"""Standard deviation of g: from a machine that does not answer to what is common (an air-conditioned room) to one that answers twice as
much lie two deviations to either side."""

MONTH = 30.0
"""Nights after which a machine's own scatter counts as much as the fleet's."""

FIRST = 9
"""Results of which the median gives a level where none is known: four bad nights among them, a long weekend, do no harm."""

WEEK = 7
"""Nights over which the common part is averaged to say how far machines may go their own way: seasons are slower, and a median of few
machines has errors of its own every night."""

EVERY_NIGHT = 16
"""Nights back to which every night is tried as the beginning; beyond, every second, fourth, ... whenever the age doubles."""

MORE = 16  # places for beginnings that are added when there are too few

SETTLED = 10
"""Nights from which on the common part's own restlessness is known well enough to call one of its moves a jump."""

JUMP = 6.0
"""Deviations of the common part's nightly moves that are a jump: chance alone has one in 10^8 nights."""


class Bank:
    """Filters of M machines and P parameters, with W beginnings of a change that are tried.

    Attributes
    ----------
    begun : list of int
        The nights that are tried as the beginning of a change, W of them.
    common : list of (P,) arrays
        The fleet's common part of every night so far, in u.
    """

    def __init__(self, machines: int, model: FleetModel) -> None:
        shape = (machines, len(model.scale))
        self.model = model
        self.state = np.zeros((*shape, 3))
        self.state[..., 0] = model.level
        self.covariance = np.zeros((*shape, 3, 3))
        self.covariance[..., 1, 1] = FOLLOWS**2
        self.covariance[..., 2, 2] = model.carried
        self.begun: list[int] = []
        self.slots = np.zeros(0, dtype=int)  # place of each beginning in the arrays below
        self.signature = np.zeros((*shape, MORE, 2, 3))
        self.evidence, self.uncut, self.information = np.zeros((3, *shape, MORE, 2))
        self.results = np.zeros(shape, dtype=int)
        self.common: list[np.ndarray] = []
        self._first = np.full((*shape, FIRST), np.nan)
        self._jumps = np.zeros(shape[1])
        self._farthest = np.zeros(shape[1])
        self._y = np.zeros(shape[1])  # the common part of y
        self._smooth: list[np.ndarray] = []
        self._before: tuple[np.ndarray, ...] = (np.full(shape, np.nan), np.zeros(shape), np.zeros(shape, dtype=int))
        self._own_scatter = np.full((2, *shape), MONTH)
        self._days = 0

    def night(
        self,
        day: int,
        u: np.ndarray,
        measured: np.ndarray,
        in_fleet: np.ndarray,
        released: np.ndarray,
        common_release: bool,
    ) -> np.ndarray:
        """Take a night's results, and return the greatest evidence for a change of every machine and parameter (M, P) [deviations].

        Parameters
        ----------
        day : int
            Number of the night, rising.
        u, measured : (M, P) arrays
            Results, NaN where there are none, and their measured variances.
        in_fleet : (M, P) array of bool
            Whose results say what is common.
        released : (M,) array of bool
            Machines whose level may have moved for a reason that is known.
        common_release : bool
            The fleet's level may have moved for a reason that is known.
        """
        passed = max(day - self._days, 1) if self.begun else 1
        self._days = day
        self._predict(passed)
        self.results[released] = 0  # the level is learned anew
        noise = (measured + self.model.white) * self._own_variance()
        common, own, doubt = self._common(u, noise, in_fleet, common_release)
        self.common.append(common)
        self._open(day)
        h = np.stack([np.ones_like(own), own, np.ones_like(own)], axis=-1)
        h = np.broadcast_to(h, self.state.shape)
        innovation = u - common - np.einsum("mpi,mpi->mp", h, self.state)
        gain_up = np.einsum("mpij,mpj->mpi", self.covariance, h)
        variance = np.einsum("mpi,mpi->mp", h, gain_up) + noise + doubt
        known = np.isfinite(innovation) & (variance > 0.0) & (self.results >= FIRST)
        variance = np.where(known, variance, 1.0)
        deviation = np.sqrt(variance)
        said = np.where(known, innovation, 0.0) / deviation
        cut = np.clip(said, -CUT, CUT)
        gain = np.where(known[..., None], gain_up / variance[..., None], 0.0)
        highest = np.zeros(u.shape)
        weight = np.where(known, 1.0 / deviation, 0.0)
        ages = day - np.array(self.begun)
        compare(self.slots, ages, own, gain, cut, said, weight, self.signature, self.evidence, self.uncut, self.information, highest)
        self.state += gain * (cut * deviation)[..., None]
        self.covariance -= gain[..., :, None] * gain_up[..., None, :]
        self._learn_scatter(u - common, noise, day)
        self._start(day, u - common, own, noise)
        return highest

    def _start(self, day: int, left: np.ndarray, own: np.ndarray, noise: np.ndarray) -> None:
        """Learn levels that are not known from a few results, what is common taken off, shrunk to the fleet's."""
        new = np.argwhere(np.isfinite(left) & (self.results < FIRST))
        for m, j in new:
            self._first[m, j, self.results[m, j]] = left[m, j] - self.state[m, j, 1] * own[j]
        self.results += np.isfinite(left)
        ages = day - np.array(self.begun) + 1.0
        for m, j in new[self.results[new[:, 0], new[:, 1]] == FIRST]:
            variance = MEDIAN_VARIANCE * (noise[m, j] + self.model.carried[j]) / FIRST
            share = self.model.spread[j] ** 2 / (self.model.spread[j] ** 2 + variance)
            self.state[m, j] = [
                self.model.level[j] + share * (np.median(self._first[m, j]) - self.model.level[j]),
                self.state[m, j, 1],
                0.0,
            ]
            self.covariance[m, j, 0], self.covariance[m, j, :, 0] = 0.0, 0.0
            follows = self.covariance[m, j, 1, 1]  # what is not known of g is not known of the level, as far as g acts now
            self.covariance[m, j, 0, 0] = share * variance + follows * own[j] ** 2
            self.covariance[m, j, 0, 1] = self.covariance[m, j, 1, 0] = -follows * own[j]
            self.signature[m, j] = 0.0
            followed = np.stack([ages > FIRST // 2, np.maximum(ages - FIRST // 2, 0.0)], axis=-1)
            self.signature[m, j, self.slots, :, 0] = followed

    def _predict(self, passed: int) -> None:
        forgotten = self.model.memory**passed
        self.state[..., 2] *= forgotten
        self.covariance[..., 2, :] *= forgotten[:, None]
        self.covariance[..., :, 2] *= forgotten[:, None]
        self.covariance[..., 2, 2] += self.model.carried * (1.0 - forgotten**2) * self._own_variance()
        self.signature[..., 2] *= forgotten[:, None, None]

    def _own_variance(self) -> np.ndarray:
        """Return each machine's scatter as a multiple of the fleet's, at least 1."""
        return np.asarray(np.maximum(self._own_scatter[0] / self._own_scatter[1], 1.0))

    def _common(self, u: np.ndarray, noise: np.ndarray, in_fleet: np.ndarray, release: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the night's common part, what of it machines may follow more or less, and the variance with which it is known."""
        count = u.shape[1]
        last = self.common[-1] if self.common else np.zeros(count)
        own = u - self.state[..., 0] - self.state[..., 2]
        known = np.isfinite(own) & in_fleet & (self.results >= FIRST)
        common, doubt = last.copy(), np.zeros(count)
        for j in np.flatnonzero(known.sum(axis=0) >= FEWEST):
            common[j] = np.median(own[known[:, j], j])
            doubt[j] = MEDIAN_VARIANCE * float(np.median(noise[known[:, j], j])) / int(known[:, j].sum())
        move = common - last
        jumped = np.full(count, release)
        if len(self.common) > SETTLED:
            moves = np.abs(np.diff(self.common, axis=0))
            usual = np.nanmedian(moves, axis=0) / MEDIAN_OF_NORMAL
            jumped |= (np.abs(move) > JUMP * usual) & (np.abs(move) > np.sqrt(np.nanmedian(noise, axis=0)))
        return common, self._own_way(own, known, last, jumped), doubt

    def _own_way(self, own: np.ndarray, known: np.ndarray, last: np.ndarray, jumped: np.ndarray) -> np.ndarray:
        """Return s, and let levels go their own way where the common part jumps."""
        results = np.where(known, own, last)[known.any(axis=1)] @ np.linalg.inv(self.model.adjustment).T
        y = np.median(results, axis=0) if len(results) >= FEWEST else self._y
        move = np.where(jumped, y - self._y, 0.0)
        self.covariance[..., 0, 0] += np.square(FOLLOWS * self._apart(move))
        self._jumps += move
        self._y = y
        self._smooth = [*self._smooth[1 - WEEK :], y - self._jumps]
        smooth = np.mean(self._smooth, axis=0)
        side = -1.0 if smooth @ self._farthest < 0.0 else 1.0  # a season swings to both sides of the first nights
        if smooth @ smooth > self._farthest @ self._farthest:
            self._farthest = side * smooth
        return np.asarray(side * self._apart(smooth))

    def _apart(self, y: np.ndarray) -> np.ndarray:
        """Return how far u may go its own way where each parameter follows what is common by a factor of its own, 1 deviation for g = 1."""
        return np.asarray(np.sqrt(np.square(self.model.adjustment) @ np.square(y)))

    def _open(self, day: int) -> None:
        """Try one beginning more, and leave out of the old ones what `EVERY_NIGHT` says."""
        ages = np.maximum(day - np.array(self.begun, dtype=int), 1)
        every = 2 ** np.maximum(np.floor(np.log2(ages / EVERY_NIGHT)) + 1, 0).astype(int)
        kept = np.array(self.begun, dtype=int) % every == 0
        self.begun = [*np.array(self.begun, dtype=int)[kept].tolist(), day]
        slots = self.slots[kept]
        free = min(set(range(len(slots) + 1)) - set(slots.tolist()))
        self.slots = np.append(slots, free)
        capacity = self.evidence.shape[2]
        if free == capacity:
            self.signature, self.evidence, self.uncut, self.information = (
                np.concatenate([array, np.zeros((*array.shape[:2], MORE, *array.shape[3:]))], axis=2)
                for array in (self.signature, self.evidence, self.uncut, self.information)
            )
        for array in (self.signature, self.evidence, self.uncut, self.information):
            array[:, :, free] = 0.0

    def evidence_of(self, machine: int) -> np.ndarray:
        """Return a machine's evidence for every change [standard deviations], (P, W, 2), beginnings as in `begun`."""
        return self._in_deviations(self.evidence, machine)

    def uncut_of(self, machine: int) -> np.ndarray:
        """Return the same from what the nights say when none is cut."""
        return self._in_deviations(self.uncut, machine)

    def _in_deviations(self, said: np.ndarray, machine: int) -> np.ndarray:
        known = self.information[machine][:, self.slots]
        return np.asarray(said[machine][:, self.slots] / np.sqrt(np.maximum(known, LEAST_INFORMATION)))

    def _learn_scatter(self, own: np.ndarray, noise: np.ndarray, day: int) -> None:
        """Compare a machine's nightly difference with what the fleet's model expects: a change shows in one difference only."""
        known = np.isfinite(own)
        before, noise_before, day_before = self._before
        apart = np.maximum(day - day_before, 1)
        expected = noise + noise_before + 2.0 * self.model.carried * self._own_variance() * (1.0 - self.model.memory**apart)
        both = known & np.isfinite(before) & (expected > 0.0)
        ratio = np.where(both, (own - before) ** 2 / np.where(both, expected, 1.0), 0.0)
        self._own_scatter[0] += np.minimum(ratio, CUT**2) / KEPT_OF_CUT * self._own_variance() * both
        self._own_scatter[1] += both
        self._before = (np.where(known, own, before), np.where(known, noise, noise_before), np.where(known, day, day_before))

"""Lost samples: readings that repeat the last one exactly while the channel must have moved, oftener in a row than noise lets them, or stay
where it was but for noise.

They are seen in the recordings themselves. Lost at other instants in every repeat, they are noise to the repeats' mean and a small lag in
it: they are taken out before anything else is looked at.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy.stats

from hil.diagnosis.recorded.held_samples import held_samples
from hil.diagnosis.recorded.noise_repeats import repeated_in_noise
from hil.diagnosis.recorded.stood_alone import stood_alone
from hil.diagnosis.result import READ_OFF, EffectAt, Estimate, Finding
from virtual_bus.settings import EffectSetting

MOVES_BY = 6.0
"""A channel moves for certain between two changes of the same sign and this many times its white noise."""

LEAST_STEPS = 40
"""Certain steps without which nothing is said."""

BY_ITSELF = 1e-3
"""Share of certain steps that may repeat a reading without a loss."""

CHANCE = 1e-6
"""Largest probability of as many repeated readings by themselves."""

COUNTS = 3.0
"""White noise of a step, in smallest steps, from which it changes nearly every reading: what repeats is lost then, in motion or not."""

MEETING = 2
"""Bursts that may follow each other without a reading between them: what repeats for longer, out of motion, is at rest."""

OF_IMU = ("imu_", "gyro_")
"""Channels of the IMU."""

NOISY = (*OF_IMU, "current_")
"""Channels that noise never leaves still; a joint that sticks between two motions repeats its encoder's reading."""


@dataclass(frozen=True)
class Dropout:
    """What a channel loses: the share of its samples with its 95 % interval, how many at once, and what shows it."""

    share: float
    ci95: tuple[float, float]
    length: float
    seen: str
    clarity: float  # samples that show it, or the logarithm of a likelihood: the larger is believed where an IMU's channels differ

    def setting(self, channel: str) -> EffectSetting:
        return EffectSetting("sample_dropout", channel, {"p": self.share, "length": self.length, "seed": 0.0})

    def finding(self, channel: str) -> Finding:
        parameters = {
            "p": Estimate(self.share, "", self.ci95),
            "length": Estimate(self.length, "", (1.0, max(2.0 * self.length, 2.0))),
        }
        return Finding(EffectAt("sample_dropout", channel), READ_OFF, parameters, evidence_for=(self.seen,))

    def says(self, channel: str) -> str:
        return f"{channel} loses {self.share:.1%} of its samples"


def without_lost_samples(
    measured: np.ndarray, simulated: np.ndarray, channels: tuple[str, ...]
) -> tuple[np.ndarray, Mapping[str, Dropout]]:
    """Take lost samples out.

    Parameters
    ----------
    measured : (R, N, C) array
    simulated : (N, C) array
    channels : tuple of str

    Returns
    -------
    measured : (R, N, C) array
        NaN where a sample is lost: a reading repeats the one before while the channel moves, or where noise would have changed it, or is
        held, or stays in one repeat alone. A reading that repeats at rest is right, and stays.
    lost : mapping of str to Dropout
        By channel.
    """
    kept = measured.copy()
    lost: dict[str, Dropout] = {}
    for c, channel in enumerate(channels):
        steps = np.diff(measured[:, :, c], axis=1)
        same = steps == 0.0
        changes = steps[~same & np.isfinite(steps)]
        noise = _white_noise(changes, steps - np.diff(simulated[:, c]))
        last, following = _changes_around(same)
        moving = _moves_around(steps, last, following, MOVES_BY * noise)
        in_motion = same & moving
        count, repeated = int(moving.sum()), int(in_motion.sum())
        if count < LEAST_STEPS or scipy.stats.binom.sf(repeated - 1, count, BY_ITSELF) > CHANCE:
            found = _without_motion(measured[:, :, c], channel)
            if found is not None:
                lost[channel], rows = found
                kept[:, :, c][rows] = np.nan
            continue
        share = repeated / count
        interval = scipy.stats.binomtest(repeated, count).proportion_ci(0.95)
        seen = f"{repeated} of {count} readings repeat the last one exactly while the channel moves"
        lost[channel] = Dropout(share, (float(interval.low), float(interval.high)), _mean_length(in_motion), seen, float(count))
        gone = in_motion
        if noise > COUNTS * np.abs(changes).min():
            length = following - last - 1
            gone = in_motion | (same & (length <= MEETING * length[in_motion].max()))
        kept[:, 1:, c][gone] = np.nan
    return kept, lost


def _without_motion(measured: np.ndarray, channel: str) -> tuple[Dropout, np.ndarray] | None:
    """What (R, N) readings of one channel lose that does not show between two steps the same way, and which rows."""
    if channel.startswith(NOISY):
        repeated = repeated_in_noise(measured, CHANCE)
        if repeated is not None:
            seen = f"{repeated.runs} times {repeated.least} readings or more in a row repeat the one before, where noise changes it"
            return Dropout(repeated.share, repeated.ci95, repeated.length, seen, float(repeated.rows.sum())), repeated.rows
    alone = stood_alone(measured)
    if alone is not None:
        return _bursts_alone(alone, measured.shape)
    held = held_samples(measured, is_never_still=channel.startswith(NOISY))
    if held is None:
        return None
    rows = int(held.rows.sum())
    seen = f"{rows} readings stay where the channel was while the other repeats move on, likelier than chance by exp({held.evidence:.0f})"
    return Dropout(held.share, held.ci95, held.length, seen, held.evidence), held.rows


def _bursts_alone(runs: np.ndarray, shape: tuple[int, ...]) -> tuple[Dropout, np.ndarray]:
    """Of runs (K, 3) of `stood_alone`; as many bursts as there are scatter as Poisson's number."""
    rows = np.zeros(shape, dtype=bool)
    for repeat, first, lasts in runs.tolist():
        rows[repeat, first : first + lasts] = True
    number, lost = len(runs), int(rows.sum())
    low, high = scipy.stats.chi2.ppf([0.025, 0.975], [2 * number, 2 * number + 2]) / (2 * number)
    share, length = lost / rows.size, lost / number
    seen = (
        f"{lost} readings of {number} {'burst' if number == 1 else 'bursts'} repeat the last one exactly while the other repeats move on,"
        " and in the next row are beside these as they were before"
    )
    return Dropout(share, (float(low * share), float(min(high * share, 1.0))), length, seen, float(lost)), rows


def _changes_around(same: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(R, N - 1) columns of the last step before each one and of the next one after it that change the reading; -1 and N - 1 for none."""
    rows = np.arange(same.shape[1])
    last = np.maximum.accumulate(np.where(same, -1, rows), axis=1)
    following = np.minimum.accumulate(np.where(same, len(rows), rows)[:, ::-1], axis=1)[:, ::-1]
    last = np.concatenate([np.full((len(same), 1), -1), last[:, :-1]], axis=1)
    following = np.concatenate([following[:, 1:], np.full((len(same), 1), len(rows))], axis=1)
    return last, following


def _moves_around(steps: np.ndarray, last: np.ndarray, following: np.ndarray, least: float) -> np.ndarray:
    """(R, N - 1) steps whose last and next change are both larger than `least` and the same way: a joint that sticks does not look so."""
    end = steps.shape[1]
    inside = (last >= 0) & (following < end)
    before = np.take_along_axis(steps, np.clip(last, 0, end - 1), axis=1)
    after = np.take_along_axis(steps, np.clip(following, 0, end - 1), axis=1)
    return inside & (np.abs(before) > least) & (np.abs(after) > least) & (before * after > 0.0)


def _white_noise(moved: np.ndarray, error: np.ndarray) -> float:
    """Rms of a step's noise: from the median of how steps differ from the simulation's, and the smallest step there is."""
    if not moved.size:
        return np.inf
    spread = float(np.nanmedian(np.abs(error - np.nanmedian(error)))) / 0.6745
    return max(spread, float(np.abs(moved).min()))


def _mean_length(same: np.ndarray) -> float:
    """Of runs of repeated readings."""
    begins = int((np.diff(same.astype(int), axis=1) == 1).sum() + same[:, 0].sum())
    return float(max(same.sum() / max(begins, 1), 1.0))


def by_sensor(lost: Mapping[str, Dropout]) -> dict[str, Dropout]:
    """The same, with an IMU named once where several of its channels lose samples."""
    imu = {name: found for name, found in lost.items() if name.startswith(OF_IMU)}
    if len(imu) < 2:
        return dict(lost)
    others = {name: found for name, found in lost.items() if name not in imu}
    return others | {"imu": max(imu.values(), key=lambda found: found.clarity)}

"""Is an effect there at all? Five questions, all of which must be answered with yes.

1. On the training repeats: would one of all candidates gain as much where there is nothing, with every order, frequency and shape that was
   searched between its starts and its fit? The noise model sets the scale, what the fit leaves raises it, and the scatter of the effect's
   strength from repeat to repeat widens it where the two disagree (a disturbance that depends on reversals is larger along a friction's
   response than the spectrum says). Beside effects that were found, what is left counts where the response is (`structure_left.py`), and of
   the gain only what no error of their equations explains (`form_error.py`).
2. On the held-out recordings, everything frozen: does the misfit fall as predicted, by more than on machines that hide nothing? They are
   independent of training and nothing is searched on them, so that the chances of both count together (Fisher). Of recordings that can
   show little of it no more is asked than that they agree, if training leaves no doubt.
3. Is it better than placebos: the candidates' own responses run backwards in time (`placebos.py`)?
4. Does it, where it is the first, explain a share of what there is to explain?
5. Is it still its own equation (`form.py`)?
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.stats

from hil.diagnosis.judging.placebos import PLACEBO_FACTOR, Beside
from hil.diagnosis.judging.structure_left import REACH_s, near_products
from hil.diagnosis.tuning.free_run import TRAIN, FreeRuns

LEVEL = 0.01
"""Chance that one of all sets that are tried gains what is needed (`needed_gain`) in training where there is nothing."""

PASSING_LEVEL = 0.05
"""Chance that one of all sets that are tried passes the first two questions where there is nothing. The count errs on the safe side: of 150
machines with nothing hidden, five fell below 0.3, where 45 were expected. A level of 0.01 would refuse single effects of 11 deviations,
whose chance is 0.012."""

PASSING_BESIDE_OTHERS = 0.025
"""The same beside effects that were found before, whose equations err. Near this level two effects that were there came with 0.020 and
0.023, and two that were not with 0.012 and 0.039."""

SIMULATOR_ERROR = 1e-3
"""Energy, in units of the noise of the repeats' mean, by which a simulation of the right machine may be off: 3 % of the noise's rms."""

PRIOR_VARIANCE, PRIOR_FREEDOM = 0.74, 4.2
"""Scale and degrees of freedom of the scaled inverse chi-squared distribution of what the noise's variance along a response is, in units of
the noise model's (empirical Bayes; Smyth 2004). With IN_SAMPLE the likeliest for 588 responses on ten machines with nothing hidden and
noise of all colours, each with the scatter of the recorded repeats and of twelve fresh ones (`benchmarks/diagnosis_noise.py --along`)."""

IN_SAMPLE = 0.67
"""Power of the recorded repeats' deviations along a response, over that of fresh repeats. The spectra were taken from the same deviations
and whiten them too well: by 1 - C / n for C channels and n degrees of freedom where the spectrum is flat (0.75; Muirhead 1982, sec. 3.2),
by more where few lines decide."""

TAIL_FREEDOM = 40.0
"""Second degrees of freedom of the F distribution of what a response gains by chance, in units of its expected variance. By the prior above
alone they would be six or seven; then the best of all sets should come as far as one does by chance on two of three machines with nothing
hidden, and did on none of 30. With 40 it did on two, with infinitely many (chi-squared) on seven. With repeats they are no more than the
prior's and those of the stretches that the response is spread over (`Along`): what comes once in a recording, an end stop near one
reversal, is known by few."""

HELD_OUT_SCALE, HELD_OUT_FREEDOM = 0.81, 5.0
"""Of the t distribution of the root of the held-out misfit's fall, in standard deviations of the noise along the response, by sets fitted
where there is nothing: likeliest for 214 sets on 29 machines with nothing hidden, of which 1.4 % come beyond 2.5, the farthest to 3.6
(`benchmarks/diagnosis_noise.py --gate`). Of 2 to 10 degrees of freedom none is much likelier."""

HELD_OUT_LEVEL = 0.05
"""Chance of the held-out fall alone below which held-out recordings confirm a set. The chances of both count together at PASSING_LEVEL;
alone the fall says that the change is not training's own. A level of 0.01 would refuse a gap of the C-arm's roll with a chance of both of
10^-6; on 67 machines with nothing hidden no set gains more than 24 in training and has a fall between the two levels."""

AS_PREDICTED = 2.5
"""Standard deviations by which held-out recordings may stay behind what was predicted of them and still agree with it: what is there does
so by more once in 160. With 2.0 it would be once in 44."""

SHORT = 5.5
"""Predicted deviations below which agreeing is enough: from there on what agrees is confirmed as well. Recordings that show little of an
effect cannot be asked to confirm it: where three deviations are predicted they do so at HELD_OUT_LEVEL with 0.85, two with 0.63, one with
0.20."""

UNCONFIRMED_LEVEL = 1e-3
"""Chance in training, as one of all that were tried, below which agreeing is enough. Of 216 machines with nothing hidden three have sets
that held-out recordings do not confirm with less than 0.003 in training; those stay 4.4 to 4.8 deviations behind what is predicted, and
none agrees. A ripple of 11 deviations had 2e-4, an inertia that varies with pose 1e-6."""

OWN_GAIN = 0.9
"""Share of a gain beside effects that were found before, above which what is beyond errors of their equations is an effect of its own."""

UNCONFIRMED_ERRORS = 1e-4
"""The same as UNCONFIRMED_LEVEL of what is less its own than that, or where no such errors are known. Beside strong first effects others
take up what their equations err by: one that was not there had 2e-4 in training and a quarter of its gain beyond such errors. Two ripples
and an inertia between axes that were there, 7 and 10 deviations long beside a mode, had 3e-4 to 6e-4 and 99 in 100 of their gain beyond."""

TRAINING_ALONE = 1e-6
"""The same below which something is there whatever held-out recordings say: a law that no known effect has may be one motion's own. Of 35
machines with nothing hidden the least was 0.04; of six with nothing hidden that raised an alarm it was 0.006."""

ERROR_FREEDOM = 5.0
"""Degrees of freedom of the t distribution of an equation's error, in units of its scale: one in a hundred is four times as long."""

ALIKE = 8.0
"""Sets that imitate an equation's error: about as many as held-out recordings are asked about."""

SIZES, LARGEST = 129, 50.0
"""Sizes of an error over which its chance is summed, and the largest, that one in ten million exceeds."""

LEAST_SHARE = 0.02
"""Of the explainable mismatch, that a first effect explains."""


@dataclass(frozen=True)
class Gate:
    """The answers, with the numbers they rest on."""

    gain: float  # fall of |residual|^2 on the training groups, nominal numbers refitted
    needed: float  # what the best of all gains by chance where the noise is as the noise model says
    scatter: float  # expected variance of the strength over repeats, in units of the noise model's
    trained: float  # expected number of all that were tried that gain as much by chance
    over_simulator: float  # the gains, the larger of training and held-out, over what the simulator's own error may be
    asked: int  # sets that the held-out recordings are asked about
    held_out_deviations: float | None  # along the predicted change; None without held-out recordings
    held_out_gain: float | None  # fall of the held-out misfit
    followed: float | None  # chance of that gain
    placebo_gain: float  # the largest of a placebo by itself
    share: float  # of what there is to explain before the first effect
    is_first: bool
    lost_form: str = ""  # what left its own equation, see form.py, or that an effect is surplus, see step.py
    beyond: float | None = None  # of the gain, what no error of equations found before explains, see form_error.py
    held_out_beyond: float | None = None  # the same of the held-out gain
    predicted: float | None = None  # length of the held-out change beyond such errors, in standard deviations of the noise along it
    seen: float | None = None  # how far the held-out recordings go along it, in the same
    beside: Beside | None = None  # what a placebo and this gain beside each other

    @property
    def explained(self) -> tuple[float, float]:
        """Of the gains in training and held out, what errors of equations found before explain; held out it may be less than nothing."""
        here = 0.0 if self.beyond is None else self.gain - self.beyond
        there = 0.0 if self.held_out_beyond is None or self.held_out_gain is None else self.held_out_gain - self.held_out_beyond
        return here, there

    @property
    def certain_gain(self) -> float:
        """The gain less what chance gains more where the strength scatters more than the noise model says; it is never worth less than in
        units of that scatter.
        """
        return max(self.gain - (self.scatter - 1.0) * self.needed, self.gain / self.scatter)

    @property
    def shows(self) -> bool:
        """Whether training shows more than what the best of all gains by chance, in units of its scatter, be it an error of what was found
        before.
        """
        return self.gain > self.scatter * self.needed

    @property
    def chance(self) -> float:
        """Of both gains where there is nothing."""
        return min(self.trained, 1.0) if self.followed is None else chance_of_both(self.trained, self.followed, self.asked)

    @property
    def significant(self) -> bool:
        """Beside others training must show it too: held-out recordings also show what training left open of the others' parameters."""
        level = PASSING_LEVEL if self.is_first else PASSING_BESIDE_OTHERS
        return self.over_simulator > 1.0 and self.chance < level and (self.is_first or self.trained < 1.0)

    @property
    def confirmed(self) -> bool:
        """Whether held-out recordings show it, or are too few to and agree."""
        return self.is_followed or self.agrees

    @property
    def is_followed(self) -> bool:
        """Whether held-out recordings, where there are any, show it by themselves."""
        return self.followed is None or self.followed < HELD_OUT_LEVEL

    @property
    def agrees(self) -> bool:
        """Whether training leaves little doubt, and held-out recordings show as much as was predicted of them, which is too little to
        confirm anything, nor do they become worse by more than chance lets the best of all gain.

        What is predicted counts in units of what errors of the first effects may do, too. Where little is predicted, agreeing is easy: a
        friction that warms, beside one over position, may leave 256 more of the held-out recordings, 96 beyond such errors, and its 2.3
        predicted deviations agree with none.
        """
        of_its_own = self.is_first or (self.beyond is not None and self.beyond > OWN_GAIN * self.gain)
        level = UNCONFIRMED_LEVEL if of_its_own else UNCONFIRMED_ERRORS
        if self.predicted is None or self.seen is None or self.held_out_gain is None or self.trained > level:
            return False
        if (self.held_out_gain if self.held_out_beyond is None else self.held_out_beyond) < -self.scatter * self.needed:
            return False
        return self.predicted < SHORT and self.predicted - self.seen <= AS_PREDICTED

    @property
    def beats_placebo(self) -> bool:
        return self._beats_placebo_in_training or self._beats_placebo_held_out

    @property
    def _beats_placebo_in_training(self) -> bool:
        """By itself, or where placebos look like it, by what is left beside them, which then must show by itself."""
        return self.gain > PLACEBO_FACTOR * self.placebo_gain or self._stands_beside_placebos

    @property
    def _stands_beside_placebos(self) -> bool:
        if self.beside is None:
            return False
        return self.beside.effect > max(PLACEBO_FACTOR * self.beside.placebo, self.scatter * self.needed)

    @property
    def _beats_placebo_held_out(self) -> bool:
        """Whether held-out recordings follow by more than any placebo gains in training, where placebos were searched."""
        gain = self.held_out_gain if self.held_out_beyond is None else self.held_out_beyond
        return self.followed is not None and self.is_followed and gain is not None and gain > PLACEBO_FACTOR * self.placebo_gain

    @property
    def explains(self) -> bool:
        return not self.is_first or self.share > LEAST_SHARE

    @property
    def something_is_there(self) -> bool:
        """Whether this effect or what it imitates."""
        return self.significant and self.confirmed and self.beats_placebo and self.explains

    @property
    def training_shows_something(self) -> bool:
        """Whether something is there by training alone, be it another law than this one."""
        return self.over_simulator > 1.0 and self.trained < TRAINING_ALONE and self._beats_placebo_in_training and self.explains

    @property
    def passed(self) -> bool:
        return self.something_is_there and not self.lost_form

    def evidence(self) -> tuple[list[str], list[str]]:
        """Sentences for and against."""
        by_chance = f"one of all that was tried gains as much by chance with a probability of {self.chance:.2g}"
        if self.followed is not None:
            by_chance = f"one of all that was tried gains as much and is followed so by chance with a probability of {self.chance:.2g}"
        backwards = f"the best response run backwards in time gains {self.placebo_gain:.4g}"
        if not self.gain > PLACEBO_FACTOR * self.placebo_gain and self.beats_placebo:
            backwards += ", less than held-out recordings follow this one by"
            if self.beside is not None and self._stands_beside_placebos:
                backwards = f"{backwards.partition(',')[0]}, as far as it looks like this one: fitted with such a one, "
                backwards += f"this one gains {self.beside.effect:.4g} and that one {self.beside.placebo:.4g}"
        lines = [
            (self.significant, f"the sum of squares in units of noise falls by {self.gain:.4g}; {by_chance}"),
            (self.beats_placebo, backwards),
            (self.explains, f"explains {self.share:.1%} of what is above noise"),
        ]
        if self.held_out_deviations is not None and self.followed is not None:
            follow = f"held-out recordings follow the prediction by {self.held_out_deviations:.3g} standard deviations"
            fall = f"their sum of squares falls by {self.held_out_gain:.4g}, by chance with a probability of {self.followed:.2g}"
            if self.agrees and not self.is_followed:
                follow = f"held-out recordings show {self.seen:.2g} standard deviations of it where {self.predicted:.2g} were predicted"
                fall = "too little to confirm it, and no less than noise explains"
            lines.insert(1, (self.confirmed, f"{follow}; {fall}"))
        if self.beyond is not None and not self.is_first:
            lines.append((self.significant, f"of the gain, {self.beyond:.4g} is nothing that an error of what was found before explains"))
        if self.lost_form:
            lines.append((False, self.lost_form))
        return [text for holds, text in lines if holds], [text for holds, text in lines if not holds]


def chance_of_both(trained: float, followed: float, asked: int) -> float:
    """Chance that where there is nothing one of all sets that were tried comes as far in training and held out together.

    Parameters
    ----------
    trained : float
        Expected number of all tried sets that gain as much in training by chance: of one set it is uniform on (0, sets tried).
    followed : float
        Chance of its held-out gain: uniform on (0, 1) and independent, because nothing is searched there.
    asked : int
        Sets that the held-out recordings are asked about. A set that gains less in training than the last of so many do counts as that one.

    Notes
    -----
    With x = min(trained, asked) * followed, the expected number of sets that come as far is the integral of min(1, x / u) over u from 0 to
    `asked`, x (1 + log(asked / x)), and at most x more of those that count as the last (Fisher's combination of two chances, counted over
    all sets).
    """
    x = min(trained, float(asked)) * followed
    return min(1.0, x * (2.0 + math.log(asked / x))) if x > 0.0 else 0.0


def chance_of_gain(gain: float, freedom: int, variance: float, known: float = TAIL_FREEDOM) -> float:
    """Of a gain in training by one set of so many parameters where there is nothing.

    Parameters
    ----------
    gain : float
    freedom : int
    variance : float
        Of the noise along the set's response, in units of the noise model's.
    known : float
        Degrees of freedom with which that is known.
    """
    return float(_chance_of_gain(np.array(gain), freedom, variance, known))


def _chance_of_gain(gains: np.ndarray, freedom: int, variance: float, known: float) -> np.ndarray:
    return np.asarray(scipy.stats.f.sf(np.maximum(gains, 0.0) / (max(freedom, 1) * variance), max(freedom, 1), known))


def expected_by_chance(trials: float, gain: float, freedom: int, variance: float, erring: float, known: float = TAIL_FREEDOM) -> float:
    """Expected number of all sets that were tried that gain as much in training where nothing is but the noise, and an error of the
    equations found before.

    Such an error is one function, whatever is searched: along a response it has an amplitude of unknown size and sign, on this scale, that
    no number of parameters and no search makes more of. What noise must gain beside it is searched. Where the error alone gains as much,
    ALIKE of the sets do.

    Parameters
    ----------
    trials : float
        Sets that were tried.
    gain : float
    freedom : int
    variance : float
        Of the noise along the set's response, in units of the noise model's.
    erring : float
        Energy of an error of size one along that response.
    known : float
        Degrees of freedom with which that variance is known.
    """
    by_noise = trials * chance_of_gain(gain, freedom, variance, known)
    if erring <= 0.0 or gain <= 0.0:
        return by_noise
    if not math.isfinite(erring):
        return max(trials, 1.0)
    most = min(math.sqrt(gain / erring), LARGEST)  # size with which the error gains as much alone
    sizes = most * np.linspace(0.0, 1.0, SIZES) ** 2
    missing = math.sqrt(gain) + math.sqrt(erring) * np.outer([-1.0, 1.0], sizes)  # what noise must reach with the error, or against it
    sets = np.minimum(trials * _chance_of_gain(missing**2, freedom, variance, known), ALIKE).sum(axis=0)
    larger = sets[-1] if most == LARGEST else 2.0 * min(trials, ALIKE)
    beside_an_error = np.trapezoid(scipy.stats.t.pdf(sizes, ERROR_FREEDOM) * sets, sizes) + scipy.stats.t.sf(most, ERROR_FREEDOM) * larger
    return max(by_noise, float(beside_an_error))


def chance_held_out(fall: float, variance: float) -> float:
    """Of a fall of the held-out misfit by a set that was fitted to training where there is nothing.

    Along a predicted change of length L, z deviations of the residual give a fall of 2 L z - L^2, at most z^2: the root of a fall is never
    more deviations than there are, and as many where the strength is right.

    Parameters
    ----------
    fall : float
    variance : float
        As `chance_of_gain` has it.
    """
    return float(scipy.stats.t.sf(math.sqrt(fall / variance) / HELD_OUT_SCALE, HELD_OUT_FREEDOM)) if fall > 0.0 else 1.0


def needed_gain(trials: float, freedom: int, left: float, entries: int) -> float:
    """Fall of |residual|^2 that a set of effects with this many parameters reaches by chance at LEVEL, as one of all that were tried.

    Every candidate has the same share of the level, and shares it among its own shapes: what has none to search pays for no other's search.
    What the fit leaves, `left`, over its `entries` is the noise's level where it is above the noise model's (an F test with so many
    entries that it is chi-squared). It is not less than the simulator's own errors may cost.
    """
    level = max(1.0, left / max(entries, 1))
    return level * max(float(scipy.stats.chi2.isf(LEVEL / max(trials, 1.0), max(freedom, 1))), SIMULATOR_ERROR * entries)


class Along(NamedTuple):
    """Of the noise along a response: its variance, in units of the noise model's, and the degrees of freedom with which that is known."""

    variance: float
    freedom: float


class Scatter:
    """How much more the strength along a change of the simulation varies from repeat to repeat than the noise model says."""

    def __init__(self, runs: FreeRuns) -> None:
        whitened = [np.stack(group) for group in runs.repeats(TRAIN)]
        self._deviations = [repeats - repeats.mean(axis=0) for repeats in whitened]
        self._channels, self._reach = len(runs.sets[TRAIN].channels), max(round(REACH_s * runs.noise.rate_Hz), 1)

    @property
    def freedom(self) -> float:
        """Degrees of freedom with which a variance along a response is known."""
        return PRIOR_FREEDOM + sum(len(deviations) - 1.0 for deviations in self._deviations)

    def along(self, response: np.ndarray) -> float:
        """Variance along a response (M,), in units of the noise model's; at least 1, and 1 without repeats."""
        return self.known_along(response).variance

    def known_along(self, response: np.ndarray) -> Along:
        """Variance along a response (M,), and how well it is known.

        Its expectation after the repeats' deviations along it have been seen, with what other machines' responses have beforehand: two or
        three strengths alone know it to a factor of two. Or what the deviations' power is where the response is, if that is more: noise
        that comes at reversals alone is strong there whatever the strengths happen to be. Stretches of a recording that are REACH_s apart
        tell it each (White 1982, see `structure_left.py`), and what is the same all along they do not show.
        """
        length = float(np.sqrt(response @ response))
        if length == 0.0:
            return Along(1.0, TAIL_FREEDOM)
        total, free, start = 0.0, 0.0, 0
        where: list[tuple[float, float, float]] = []  # of every experiment its share of the response, variance there and stretches
        for deviations in self._deviations:
            own = response[start : start + deviations.shape[1]]
            start += deviations.shape[1]
            size = float(np.sqrt(own @ own))
            if len(deviations) < 2 or size < 0.1 * length:
                continue
            along = deviations @ own / size
            total += float(along @ along) / IN_SAMPLE
            free += len(deviations) - 1.0
            own = own / size
            where.append(((size / length) ** 2, self._where(own, deviations), self._stretches(own) * (len(deviations) - 1.0)))
        if free == 0.0:
            return Along(1.0, TAIL_FREEDOM)
        shares, variances, counts = (np.array(each) for each in zip(*where, strict=True))
        shares = shares / shares.sum()
        stretches = 1.0 / float(np.sum(shares**2 / counts))
        local = stretches * float(shares @ variances) / IN_SAMPLE
        variance = max(1.0, _expected_variance(total, free), _expected_variance(local, stretches))
        return Along(variance, min(PRIOR_FREEDOM + stretches, TAIL_FREEDOM))

    def _where(self, response: np.ndarray, deviations: np.ndarray) -> float:
        """Variance of repeats' deviations (R, M) along a unit response (M,) by the power that they have where it is."""
        scores = (deviations * response).reshape(len(deviations), -1, self._channels).sum(axis=2)
        return sum(near_products(rows, self._reach) for rows in scores) / (len(deviations) - 1.0)

    def _stretches(self, response: np.ndarray) -> float:
        """Stretches of a recording that a response (M,) is spread over, equally, as far as its sum of squares tells."""
        rows = (response**2).reshape(-1, self._channels).sum(axis=1)
        each = np.add.reduceat(rows, np.arange(0, len(rows), self._reach))
        return float(each.sum() ** 2 / (each @ each))


def _expected_variance(total: float, free: float) -> float:
    """Of a variance whose estimates, `free` of them, sum up to `total`, with what is known beforehand."""
    return (PRIOR_FREEDOM * PRIOR_VARIANCE + total) / (PRIOR_FREEDOM + free - 2.0)

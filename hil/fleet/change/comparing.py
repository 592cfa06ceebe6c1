"""The compiled part of the bank: what one night says for each beginning of a change that is tried."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

LEAST_INFORMATION = 1e-12  # below, nothing was said yet


@njit(cache=True)
def compare(
    slots: np.ndarray,
    ages: np.ndarray,
    own: np.ndarray,
    gain: np.ndarray,
    cut: np.ndarray,
    said: np.ndarray,
    weight: np.ndarray,
    signature: np.ndarray,
    evidence: np.ndarray,
    uncut: np.ndarray,
    information: np.ndarray,
    highest: np.ndarray,
) -> None:
    """Add what a night says; a unit step, and a growth of 1 a night, leave less and less of the innovation as the filter follows them.

    Parameters
    ----------
    slots, ages : (W,) arrays of int
        Place of each beginning in the arrays below, and nights since it.
    own : (P,) array
        How far a machine may go its own way on this night.
    gain : (M, P, 3) array
        Of the filters; 0 where there is no result.
    cut, said, weight : (M, P) arrays
        Innovation in its deviations, cut and not; one over the deviation, 0 where there is no result.
    signature : (M, P, C, 2, 3) array
        What each filter has followed of each change; brought up to date here, as are the next three.
    evidence, uncut, information : (M, P, C, 2) arrays
    highest : (M, P) array
        Takes the greatest evidence [standard deviations] over beginnings and kinds.
    """
    machines, parameters = cut.shape
    for m in range(machines):
        for j in range(parameters):
            most = 0.0
            for place in range(len(slots)):
                slot = slots[place]
                for kind in range(2):
                    followed = signature[m, j, slot, kind]
                    shape = 1.0 if kind == 0 else ages[place] + 1.0
                    left = shape - followed[0] - own[j] * followed[1] - followed[2]
                    for i in range(3):
                        followed[i] += gain[m, j, i] * left
                    left *= weight[m, j]
                    evidence[m, j, slot, kind] += left * cut[m, j]
                    uncut[m, j, slot, kind] += left * said[m, j]
                    information[m, j, slot, kind] += left * left
                    known = information[m, j, slot, kind]
                    if known > LEAST_INFORMATION:
                        most = max(most, abs(evidence[m, j, slot, kind]) / math.sqrt(known))
            highest[m, j] = most

"""Sensitivities of the tuned numbers along a fit: one matrix that fits share, and what a fit's own steps have shown of it since.

A step that was taken shows what the sensitivities are along it. Broyden's update is the least change of them that agrees: with the step s,
the change y of the prediction and the sensitivities B of all that is fitted, B + (y - B s) s' / (s's) (Nocedal and Wright 2006, ch. 11.1).
It costs no run.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class TunedSensitivities:
    """J + sum of e w' over the steps since J was taken.

    Attributes
    ----------
    taken : (M, P) array
        J, the same for all fits that begin with it.
    square : (P, P) array
        Of the whole.
    missed, shares : tuples of (M,) and (P,) arrays
        e and w.
    """

    taken: np.ndarray
    square: np.ndarray
    missed: tuple[np.ndarray, ...] = ()
    shares: tuple[np.ndarray, ...] = ()

    @classmethod
    def of(cls, jacobian: np.ndarray) -> TunedSensitivities:
        return cls(jacobian, jacobian.T @ jacobian)

    def along(self, move: np.ndarray) -> np.ndarray:
        """(M,) change of the prediction for one (P,) of the tuned coordinates."""
        change = self.taken @ move
        for missed, share in zip(self.missed, self.shares, strict=True):
            change += missed * float(share @ move)
        return change

    def across(self, vectors: np.ndarray) -> np.ndarray:
        """(P, ...) products with vectors (M, ...)."""
        products = self.taken.T @ vectors
        for missed, share in zip(self.missed, self.shares, strict=True):
            products += np.multiply.outer(share, missed @ vectors)
        return products

    def after(self, move: np.ndarray, others: float, missed: np.ndarray) -> TunedSensitivities:
        """With what a step has shown.

        Parameters
        ----------
        move : (P,) array
            Of the tuned coordinates.
        others : float
            Square of what the step moved besides, in its own units: that much of what it missed is not these numbers'.
        missed : (M,) array
            Change of the prediction beyond what the sensitivities said.
        """
        share = move / max(float(move @ move) + others, 1e-300)
        product = np.outer(self.across(missed), share)
        square = self.square + product + product.T + float(missed @ missed) * np.outer(share, share)
        return TunedSensitivities(self.taken, square, (*self.missed, missed), (*self.shares, share))

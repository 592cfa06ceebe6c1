"""Noise settings of an observer, frozen, in SI and the drives' units."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class ObserverNoise:
    """Standard deviations of every random quantity in the observer's model.

    Parameters
    ----------
    command : (n_axes,) array
        Of the effort that acts beside the command, white from sample to sample: quantisation, ripple [drive's unit].
    disturbance : (disturbances,) array
        In steady state, in the unit that the model's directions give each: without directions rad/s^2 on the axes and the modes' own unit
        on the modes.
    disturbance_time_s : (disturbances,) array
        Their correlation time: first-order coloured noise. Infinite: a random walk, with `disturbance` per sqrt(s).
    disturbance_Hz : (disturbances,) array
        Centre of a disturbance's band, which has no power at zero frequency; 0: first order, strongest at zero frequency. Empty: all are of
        first order.
    low_pass : (disturbances,) array of bool
        Which of those with a frequency are low passes of second order instead: flat below it, falling with its square above, with damping
        ratio 1 / (ω τ). Empty: none.
    bias_walk : (6 sensors,) array
        Of the sensors' biases, per sqrt(s).
    adapted_walk : float
        Of the adapted modes' log frequency ratio, per sqrt(s).
    measurement : (measurements,) array
        White, of every measured channel.
    initial_bias : (6 sensors,) array
        Of the biases when the observer starts.
    initial_adapted : float
        Of the log frequency ratios when it starts.
    offset_walk : (n_axes,), (n_axes + 6,) or (2 n_axes + 6,) array
        Of the offsets of the motor sides' encoders, then of the detector's twist, then of the link sides' encoders, per sqrt(s) [rad or m].
        Empty: offsets are no states.
    initial_offset : array of the same length
        Of the offsets, at the start and at any time: they are processes of first order, over short times a random walk. Zero: no offset.
    initial_gain : (7 sensors,) array
        Of what does not change in a run and is expected to be zero: a sensor's turn in its mount (3) [rad], the scale of its
        accelerometers (3) and of its gyros. Empty: no states.
    bias : (6 sensors,) array
        Expected value of the biases when it starts; empty: zero.
    published : (quantities,) array
        By what stated deviations of `publish.QUANTITIES` are multiplied, so that they are true; empty: 1.
    usual : (windows, measurements) array
        Squared semi-axes of the ellipsoid that the mean whitened innovations over each of `consistency.WINDOWS_s`, over the deviation of
        such a mean of white ones, do not leave on a sound machine. Empty: not known. An observer that adapts modes does not look at it:
        while a frequency still moves, innovations are others.
    """

    command: np.ndarray
    disturbance: np.ndarray
    disturbance_time_s: np.ndarray
    bias_walk: np.ndarray
    measurement: np.ndarray
    initial_bias: np.ndarray
    adapted_walk: float = 0.0
    initial_adapted: float = 0.1
    disturbance_Hz: np.ndarray = field(default_factory=lambda: np.zeros(0))
    low_pass: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=bool))
    bias: np.ndarray = field(default_factory=lambda: np.zeros(0))
    offset_walk: np.ndarray = field(default_factory=lambda: np.zeros(0))
    initial_offset: np.ndarray = field(default_factory=lambda: np.zeros(0))
    initial_gain: np.ndarray = field(default_factory=lambda: np.zeros(0))
    published: np.ndarray = field(default_factory=lambda: np.zeros(0))
    usual: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

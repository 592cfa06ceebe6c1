"""A check that the pose stands still enough for a frequency response at a frozen pose, thesis Sec. 4.8."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil.errors import IdentificationError
from hil.identification.result import FrequencyResponse


@dataclass(frozen=True)
class FrozenPoseCheck:
    """How far the excitation's motion alters the dynamics it is meant to measure.

    Attributes
    ----------
    motion_rms : (n_axes,) of the positions, rad or m.
    change : (L,) change of an element over that motion as a share of its noise's standard deviation, the largest of all elements and
        pairs of neighbouring poses; below 1 the pose counts as frozen.
    largest_scale : factor by which the excitation may be scaled with `change` at most 1 at 95 % of the lines; noise falls as the
        excitation grows and motion rises, so the share goes with the square of the scale.
    """

    motion_rms: np.ndarray
    change: np.ndarray
    largest_scale: float


def frozen_pose_check(responses: Sequence[FrequencyResponse], excitation_rms: np.ndarray, direction: int) -> FrozenPoseCheck:
    """Compare the response's change over the excitation's motion with its uncertainty, Sec. 4.8, last paragraphs.

    Parameters
    ----------
    responses : at poses that differ in `direction`, with G_wz, positions among the outputs, measured with `excitation_rms`.
    excitation_rms : (n_u,) rms of each input's excitation, spread evenly over the lines.
    direction : scheduling parameter whose motion counts; the axis of the same place among the `position_` outputs.
    """
    if len(responses) < 2:
        raise IdentificationError("the frozen-pose check needs responses at two or more poses")
    ordered = sorted(responses, key=lambda response: response.pose[direction])
    positions = [i for i, name in enumerate(ordered[0].output_names) if name.startswith("position_")]
    if direction >= len(positions):
        raise IdentificationError("the frozen-pose check needs the axes' positions among the outputs")
    L = len(ordered[0].lines)
    motion = np.max([np.sqrt(np.sum(np.abs(r.G_wz[:, positions]) ** 2 * excitation_rms**2, axis=(0, 2)) / L) for r in ordered], axis=0)
    shares = []
    for low, high in itertools.pairwise(ordered):
        slope = (high.G - low.G) / (high.pose[direction] - low.pose[direction])
        deviation = np.minimum(low.standard_deviation("noise"), high.standard_deviation("noise"))
        difference = np.maximum(
            np.abs(high.G - low.G) ** 2 - low.standard_deviation("noise") ** 2 - high.standard_deviation("noise") ** 2, 0.0
        )
        significant = np.sqrt(difference) / np.maximum(np.abs(high.G - low.G), np.finfo(float).tiny)
        shares.append(np.max(np.abs(slope) * significant * motion[direction] / deviation, axis=(1, 2)))
    change = np.max(shares, axis=0)
    return FrozenPoseCheck(motion, change, float(1.0 / np.sqrt(max(np.quantile(change, 0.95), np.finfo(float).tiny))))

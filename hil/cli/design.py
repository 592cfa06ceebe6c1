"""`run multisine --design FRF...`: lines, weights and amplitude of the next experiment from what earlier ones identified."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hil.errors import ExperimentError

if TYPE_CHECKING:
    from hil.identification import FrequencyResponse
    from hil.machine import Machine

FROZEN = 1e-6  # rad or m: poses closer than this in a direction are the same


@dataclass(frozen=True)
class Designed:
    """Lines, their weights, amplitude by axis (None: not known from the responses) and notes."""

    lines: tuple[int, ...]
    weights: tuple[float, ...]
    amplitude: dict[str, float] | None
    notes: tuple[str, ...]


def designed(
    files: Sequence[Path],
    machine: Machine,
    axes: Sequence[str],
    *,
    count: int,
    band_Hz: tuple[float, float],
    period_s: float,
    odd: bool,
    jog_line: int | None,
) -> Designed:
    """Design the excitation of `axes` from the responses in `files`.

    Raises
    ------
    ExperimentError
        Responses of another machine's sample rate or axes.
    IdentificationError
        Unusable files; a band the responses do not cover, or with fewer lines than asked for.
    """
    import numpy as np

    from hil.identification import design_excitation, read_frf

    responses = [read_frf(file) for file in files]
    for file, response in zip(files, responses, strict=True):
        if not np.isclose(response.sample_rate_Hz, machine.sample_rate_Hz):
            raise ExperimentError(
                f"--design {file}: sampled at {response.sample_rate_Hz:g} Hz; {machine.name} runs at {machine.sample_rate_Hz:g} Hz"
            )
        known = {name.partition("_")[2] for name in response.input_names}
        for axis in axes or machine.axes:
            if axis not in known:
                raise ExperimentError(f"--design {file}: no response to axis {axis}; it has {', '.join(sorted(known))}")
    design = design_excitation(
        responses,
        lines=count,
        band_Hz=band_Hz,
        period_samples=round(period_s * machine.sample_rate_Hz),
        odd=odd,
        without=() if jog_line is None else (jog_line,),
    )
    amplitude, note = _amplitude(responses, axes or machine.axes)
    low, high = design.frequencies_Hz[[0, -1]]
    lines_note = f"{len(design.lines)} lines from {low:.3g} to {high:.3g} Hz, designed from {len(files)} responses"
    return Designed(tuple(map(int, design.lines)), tuple(map(float, design.weights)), amplitude, (lines_note, note))


def _amplitude(responses: Sequence[FrequencyResponse], axes: Sequence[str]) -> tuple[dict[str, float] | None, str]:
    """Return amplitudes by the frozen-pose check where the responses' poses differ in one direction."""
    import numpy as np

    from hil.identification import frozen_pose_check
    from hil.identification.design.excitation import EXCITATION_RMS

    first = responses[0]
    measured_with = [first.settings.get(f"{EXCITATION_RMS} {name}") for name in first.input_names]
    poses = np.array([response.pose for response in responses])
    directions = np.flatnonzero(np.ptp(poses, axis=0) > FROZEN) if poses.size else np.zeros(0, int)
    if len(directions) != 1:
        return None, "no frozen-pose check: it takes responses at poses that differ in one axis"
    if None in measured_with:
        return None, "no frozen-pose check: the responses do not say with which amplitude they were measured"
    rms = np.array(measured_with, float)
    check = frozen_pose_check(responses, rms, int(directions[0]))
    scale = min(check.largest_scale, 1.0)  # never above the amplitude of the measured responses, which is known to be safe
    amplitude = {name.partition("_")[2]: float(value * scale) for name, value in zip(first.input_names, rms, strict=True)}
    known = f"frozen-pose check: the pose counts as frozen up to {check.largest_scale:.3g} times the amplitude measured with"
    return {axis: amplitude[axis] for axis in axes}, f"{known}; {scale:.3g} times is used"

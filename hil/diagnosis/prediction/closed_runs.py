"""Errors of free runs of the closed loop beside recordings, by channel and stage."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hil.diagnosis.free_runs.runs import FreeRuns, Trial, mean_of, measured_by, readings_of, simulated_loop
from hil.diagnosis.prediction.open_runs import Predicted
from hil.diagnosis.residuals.residuals import Residuals
from hil.recording.ticks import on_every_tick
from hil.simulation import Simulator
from hil.simulation.simulate import inputs_of
from hil.simulation.simulator import Outputs
from hil.simulation.smooth import smooth


def closed_runs(free: FreeRuns, residuals: Residuals, stages: Mapping[str, Trial]) -> Predicted:
    """Return rms errors of whole recordings, or of means of repeats, over the rms of the recording about its mean.

    The zero of an encoder, which differs from one recording to another, is fitted in every stage. Noise is what repeats show, and
    what sensors' steps make alike in all of them.

    Parameters
    ----------
    free : FreeRuns
        Its repeats tell the noise.
    residuals : Residuals
        The recordings that are predicted: held-out ones, or those of the answer.
    stages : mapping of str to (numbers, effects)

    Raises
    ------
    RecordingError
        A recording has not all that the loop was given.
    """
    scatter = _scatter(free)
    rows: dict[str, dict[str, list[np.ndarray]]] = {}
    for trajectory, group in zip(residuals.trajectories, residuals.groups, strict=True):
        first, encoders = group.repeats[0], {encoder.channel for encoder in trajectory.settings.encoders}
        simulator = Simulator(smooth(simulated_loop(first)))
        inputs = inputs_of(simulator.machine, on_every_tick(first.recording))
        channels, parts, each = measured_by(group)
        mean, is_missing = mean_of(each)
        mean[is_missing] = np.nan
        machines = [
            (free.numbers.values(offset[: len(free.numbers.indices)]), (*trajectory.known, *own)) for offset, own in stages.values()
        ]
        for stage, outputs in zip(stages, simulator.run_all(inputs, machines), strict=True):
            for c, channel in enumerate(channels):
                if channel in scatter:
                    table = rows.setdefault(channel, {})
                    off = np.full(len(mean), np.inf)
                    if isinstance(outputs, Outputs):
                        off = mean[:, c] - readings_of(simulator, outputs, parts, channels)[:, c]
                        off -= np.nanmean(off) if channel in encoders else 0.0
                    table.setdefault(stage, []).append(off)
                    table.setdefault("about its mean", []).append(mean[:, c] - np.nanmean(mean[:, c]))
    fewest = min(len(group.repeats) for group in residuals.groups)
    errors = {channel: {stage: _rms(parts) for stage, parts in table.items()} for channel, table in rows.items()}
    found = {}
    for channel, of_stages in errors.items():
        own, common = scatter[channel]
        of_stages["noise"] = float(np.sqrt(own / fewest + common))
        if (spread := of_stages.pop("about its mean")) > 0.0 and of_stages["noise"] > 0.0:
            found[channel] = {stage: error / spread for stage, error in of_stages.items()}
    return Predicted(None, found, errors_of="closed_loop")


def _scatter(free: FreeRuns) -> dict[str, tuple[float, float]]:
    """Return the variance of one recording by channel, as repeats scatter, and the mean square that all have alike."""
    found = {}
    for channel in [channel for channel in free.runs[0].channels if all(channel in run.channels for run in free.runs)]:
        own = [(run.deviations[:, :, run.channels.index(channel)], len(run.deviations)) for run in free.runs]
        common = [run.alike[:, run.channels.index(channel)] for run in free.runs]
        scattered = np.mean([np.mean(deviations**2) * count / (count - 1) for deviations, count in own])
        found[channel] = float(scattered), float(np.mean([np.mean(each**2) for each in common]))
    return found


def _rms(parts: list[np.ndarray]) -> float:
    return float(np.sqrt(np.nanmean(np.concatenate(parts) ** 2)))

"""Frequency responses from recordings: one call for every method."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from hil.identification.bla import fast_bla, robust_bla
from hil.identification.errors import IdentificationError
from hil.identification.from_recordings import PlantInput, records_from
from hil.identification.records import PeriodicRecords
from hil.identification.result import FrequencyResponse
from hil.recording.model import Recording

METHODS: dict[str, Callable[[PeriodicRecords], FrequencyResponse]] = {
    "robust_bla": robust_bla,
    "fast_bla": fast_bla,
}


def identify(
    recordings: Sequence[Recording],
    method: str = "robust_bla",
    *,
    axes: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    plant_input: PlantInput = "command",
    settle_periods: int | None = None,
) -> FrequencyResponse:
    """Identify the frequency response matrix at one pose.

    Parameters
    ----------
    recordings : experiments and realisations of one pose.
    method : one of `METHODS`.
    axes, outputs, plant_input, settle_periods : see `hil.identification.from_recordings.records_from`.

    Raises
    ------
    IdentificationError, RecordingError
        One line on what is wrong with the recordings or the method.
    """
    if method not in METHODS:
        raise IdentificationError(f"unknown method {method}; there are {', '.join(METHODS)}")
    records = records_from(recordings, axes=axes, outputs=outputs, plant_input=plant_input, settle_periods=settle_periods)
    return METHODS[method](records)

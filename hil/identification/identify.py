"""Frequency responses from recordings: one call for every method on periodic excitations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from hil.identification.bla import fast_bla, robust_bla
from hil.identification.errors import IdentificationError
from hil.identification.from_recordings import PlantInput, by_pose, records_from
from hil.identification.local_fast import PoseModel, fast_local, nd_local
from hil.identification.local_model import LocalModel
from hil.identification.local_robust import robust_local
from hil.identification.records import PeriodicRecords
from hil.identification.result import FrequencyResponse
from hil.recording import Recording


def _polynomial(model: LocalModel | None) -> LocalModel:
    return replace(model or LocalModel(), denominator=0)


METHODS: dict[str, Callable[[PeriodicRecords, LocalModel | None], FrequencyResponse]] = {
    "robust_bla": lambda records, _: robust_bla(records),
    "fast_bla": lambda records, _: fast_bla(records),
    "robust_lpm": lambda records, model: robust_local(records, _polynomial(model)),
    "robust_lrm": robust_local,
    "fast_lpm": lambda records, model: fast_local(records, _polynomial(model)),
    "fast_lrm": fast_local,
}
"""Methods for one pose."""

POSE_METHODS = ("nd_lpm", "nd_lrm")
"""Methods that use neighbouring poses."""


def identify(
    recordings: Sequence[Recording],
    method: str = "robust_bla",
    *,
    model: LocalModel | None = None,
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
    model : orders and windows of a local method.
    axes, outputs, plant_input, settle_periods : see `hil.identification.from_recordings.records_from`.

    Raises
    ------
    IdentificationError, RecordingError
        One line on what is wrong with the recordings or the method.
    """
    if method not in METHODS:
        hint = "; it needs several poses: use identify_poses" if method in POSE_METHODS else ""
        raise IdentificationError(f"unknown method {method} for one pose; there are {', '.join(METHODS)}{hint}")
    records = records_from(recordings, axes=axes, outputs=outputs, plant_input=plant_input, settle_periods=settle_periods)
    return METHODS[method](records, model)


def identify_poses(
    recordings: Sequence[Recording],
    method: str = "nd_lrm",
    *,
    model: LocalModel | None = None,
    over_poses: PoseModel | None = None,
    axes: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    plant_input: PlantInput = "command",
    settle_periods: int | None = None,
) -> tuple[FrequencyResponse, ...]:
    """Identify one frequency response matrix per start pose found in the recordings, poses in ascending order.

    Parameters
    ----------
    method : one of `METHODS`, pose by pose, or of `POSE_METHODS`, which let neighbouring poses help.
    over_poses : orders and windows over the poses, for `POSE_METHODS`.
    The rest as in `identify`.
    """
    if method not in METHODS and method not in POSE_METHODS:
        raise IdentificationError(f"unknown method {method}; there are {', '.join((*METHODS, *POSE_METHODS))}")
    groups = [
        records_from(group, axes=axes, outputs=outputs, plant_input=plant_input, settle_periods=settle_periods)
        for group in by_pose(recordings)
    ]
    if method in METHODS:
        return tuple(METHODS[method](records, model) for records in groups)
    return nd_local(groups, _polynomial(model) if method == "nd_lpm" else model, over_poses)

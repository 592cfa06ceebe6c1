"""Frequency responses from recordings: one call for every method."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from hil.errors import IdentificationError
from hil.identification.bla.fast_bla import fast_bla
from hil.identification.bla.robust_bla import robust_bla
from hil.identification.design.excitation import EXCITATION_RMS
from hil.identification.from_recordings import Channels, PlantInput, arbitrary_records, by_pose, records_from
from hil.identification.local.local_model import LocalModel
from hil.identification.lpm_lrm.arbitrary_lpm_lrm import arbitrary_local
from hil.identification.lpm_lrm.fast_lpm_lrm import fast_local
from hil.identification.lpm_lrm.nd_lpm_lrm import ONE_POSE, PoseModel, nd_local
from hil.identification.lpm_lrm.order_selection import default_candidates, select_local_model
from hil.identification.lpm_lrm.robust_lpm_lrm import robust_local
from hil.identification.records import PeriodicRecords
from hil.identification.result import EMULATED, FrequencyResponse
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

ARBITRARY_METHODS = ("arbitrary_lpm", "arbitrary_lrm")
"""Methods for any excitation, one pose or many."""

SELECTABLE = ("fast_lpm", "fast_lrm", *POSE_METHODS)
"""Methods whose orders and windows can be chosen from the data."""


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
        hint = "; for this one use identify_poses" if method in (*POSE_METHODS, *ARBITRARY_METHODS) else ""
        raise IdentificationError(f"unknown method {method} for one pose; there are {', '.join(METHODS)}{hint}")
    records = records_from(recordings, axes=axes, outputs=outputs, plant_input=plant_input, settle_periods=settle_periods)
    return _with_origin(_estimate(records, method, model), recordings)


def identify_poses(
    recordings: Sequence[Recording],
    method: str = "nd_lrm",
    *,
    model: LocalModel | None = None,
    over_poses: PoseModel | None = None,
    select: bool = False,
    band_Hz: tuple[float, float] | None = None,
    axes: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    plant_input: PlantInput = "command",
    settle_periods: int | None = None,
) -> tuple[FrequencyResponse, ...]:
    """Identify one frequency response matrix per start pose found in the recordings, poses in ascending order.

    Parameters
    ----------
    method : one of `METHODS`, pose by pose, of `POSE_METHODS`, which let neighbouring poses help, or of `ARBITRARY_METHODS`.
    over_poses : orders and windows over the poses, for `POSE_METHODS` and `ARBITRARY_METHODS`; None takes the former's defaults, and lets
        every pose stand alone with the latter.
    select : choose orders and windows from the data instead, for `SELECTABLE` methods.
    band_Hz : band of an arbitrary method.
    The rest as in `identify`.

    Raises
    ------
    IdentificationError, RecordingError
        As `identify`; a selection or a band that does not go with the method.
    """
    known = (*METHODS, *POSE_METHODS, *ARBITRARY_METHODS)
    if method not in known:
        raise IdentificationError(f"unknown method {method}; there are {', '.join(known)}")
    if select and method not in SELECTABLE:
        raise IdentificationError(f"orders cannot be selected for {method}: they can for {', '.join(SELECTABLE)}")
    if select and (model is not None or over_poses is not None):
        raise IdentificationError("orders are either given or selected, not both")
    if model is not None and method.endswith("bla"):
        raise IdentificationError(f"{method} has no orders; the local methods have: {', '.join(m for m in known if not m.endswith('bla'))}")
    if over_poses is not None and method in METHODS:
        raise IdentificationError(f"{method} works pose by pose; over poses work {', '.join((*POSE_METHODS, *ARBITRARY_METHODS))}")
    if (band_Hz is None) == (method in ARBITRARY_METHODS):
        raise IdentificationError(
            f"{method} takes the excited lines, not a band"
            if band_Hz
            else f"{method} needs the band that is excited: band_Hz (--band LOW:HIGH)"
        )
    channels: Channels = {"axes": axes, "outputs": outputs, "plant_input": plant_input}
    polynomial = method.endswith("lpm")
    chosen = _polynomial(model) if polynomial else model
    groups = by_pose(recordings)
    if band_Hz is not None:
        found = arbitrary_local([arbitrary_records(group, **channels) for group in groups], band_Hz, chosen, over_poses or ONE_POSE)
        return tuple(_with_origin(response, recordings) for response in found)
    records = [records_from(group, **channels, settle_periods=settle_periods) for group in groups]
    if method in METHODS:
        alone = (_estimate(each, method, _selected([each], polynomial)[0] if select else model) for each in records)
        return tuple(_with_origin(response, recordings) for response in alone)
    if select:
        chosen, over_poses = _selected(records, polynomial)
    responses = nd_local(records, chosen, over_poses)
    with_amplitude = (_with_amplitude(response, each) for response, each in zip(responses, records, strict=True))
    return tuple(_with_origin(response, recordings) for response in with_amplitude)


def _estimate(records: PeriodicRecords, method: str, model: LocalModel | None) -> FrequencyResponse:
    return _with_amplitude(METHODS[method](records, model), records)


def _with_amplitude(response: FrequencyResponse, records: PeriodicRecords) -> FrequencyResponse:
    """Keep each input's rms while it is excited, for `hil.identification.design.frozen_pose.frozen_pose_check`."""
    square = np.mean(records.excitation**2, axis=2).reshape(-1, records.n_inputs)  # (records, n_u)
    excited = np.maximum(np.sum(square > 0.0, axis=0), 1)
    rms = np.sqrt(square.sum(axis=0) / excited)
    kept = {f"{EXCITATION_RMS} {name}": float(value) for name, value in zip(response.input_names, rms, strict=True)}
    return replace(response, settings={**response.settings, **kept})


def _with_origin(response: FrequencyResponse, recordings: Sequence[Recording]) -> FrequencyResponse:
    """Keep in the settings that a recording was made on the emulator, so that what is made of the response can say so."""
    if not any(recording.emulated for recording in recordings):
        return response
    return replace(response, settings={**response.settings, EMULATED: 1})


def _selected(records: Sequence[PeriodicRecords], polynomial: bool) -> tuple[LocalModel, PoseModel]:
    candidates = [each for each in default_candidates(records[0], len(records)) if (each.model.denominator == 0) == polynomial]
    chosen = select_local_model(records, candidates).chosen
    return chosen.model, chosen.over_poses

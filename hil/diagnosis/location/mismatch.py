"""The mismatch that an answer explains, or leaves, as it is located."""

from __future__ import annotations

import numpy as np

from hil.diagnosis.candidates.columns import Column, column
from hil.diagnosis.location.location import Mismatch, locate
from hil.diagnosis.model_choice.fitting import Fitted
from hil.diagnosis.model_choice.plausibility import signals_of
from hil.diagnosis.observed.groups import Group
from hil.diagnosis.residuals.residuals import Residuals
from hil.diagnosis.result import Location
from hil.diagnosis.retuning.linear_model import LinearModel, LinearRecord


def where_it_is(residuals: Residuals, linear: LinearModel, best: Fitted) -> Location:
    """Return where the effects of an answer act, or, without any, where what is left is.

    An effort that is missing on a driven joint counts for the channel of its drive's effort, all else for the channels that show it.
    """
    found: list[Mismatch] = []
    fewest = min(len(group.repeats) for group in residuals.groups)  # whose mean's noise is that of all
    shares: dict[str, float] = {}
    settings = linear.records[0].equations.trajectory.settings
    drives = {drive.joint: f"{'current' if drive.unit == 'A' else 'effort'}_{drive.axis}" for drive in settings.drives}
    for group, one, left in zip(residuals.groups, linear.records, best.innovations, strict=True):
        trajectory = one.equations.trajectory
        rows = one.equations.left.shape[0]
        channels = [*trajectory.observed.channels, *(drives[drive.joint] for drive in trajectory.settings.drives)]
        parts: dict[str | None, Column] = {None: Column({}, {})}
        if best.settings:
            change = column(one.signals, signals_of(linear, one, best.settings))
            by_joint = {trajectory.joints[joint]: {joint: effort} for joint, effort in change.efforts.items()}
            undriven = [efforts for name, efforts in by_joint.items() if name not in drives]
            parts = {None: Column({joint: effort for one_of in undriven for joint, effort in one_of.items()}, change.readings)}
            parts |= {drives[name]: Column(one_of, {}) for name, one_of in by_joint.items() if name in drives}
            whitened = one.whiten(list(parts.values()))
            white = whitened.sum(axis=1).reshape(rows, -1)
        else:
            whitened, white = left[:, None], left.reshape(rows, -1)
        for name, values in zip(parts, whitened.T, strict=True):
            each = np.sum(values.reshape(rows, -1) ** 2 - (0.0 if best.settings else 1.0), axis=0)
            for channel, power in zip([name] * len(each) if name else channels, each, strict=True):
                shares[str(channel)] = shares.get(str(channel), 0.0) + max(float(power), 0.0)
        found.append(_mismatch(group, one, white / np.sqrt(fewest), 0.0 if best.settings else 1.0 / len(group.repeats)))
    total = sum(shares.values())
    if total <= 0.0:
        return Location()
    return locate([drive.axis for drive in settings.drives], found, {name: share / total for name, share in shares.items()})


def _mismatch(group: Group, one: LinearRecord, white: np.ndarray, left: float) -> Mismatch:
    trajectory, motion = one.equations.trajectory, one.motion
    joints = [trajectory.joints.index(drive.joint) for drive in trajectory.settings.drives]
    begins = tuple((repeat.name, repeat.begin_s) for repeat in group.repeats)
    return Mismatch(
        begins, trajectory.observed.time, white, left, motion.position[:, joints], motion.speed[:, joints], trajectory.observed.targets
    )

"""The mismatch that an answer explains, or leaves, as it is located."""

from __future__ import annotations

import numpy as np

from hil.diagnosis.candidates.columns import Column, column
from hil.diagnosis.locating.location import Mismatch, locate
from hil.diagnosis.named.fitting import Fitted
from hil.diagnosis.named.plausible import signals_of
from hil.diagnosis.observed.groups import Group
from hil.diagnosis.result import Location
from hil.diagnosis.seen.see import Seen
from hil.diagnosis.tuned.retuning import Looked, Tuned


def where_it_is(seen: Seen, tuned: Tuned, best: Fitted) -> Location:
    """Return where the effects of an answer act, or, without any, where what is left is.

    An effort that is missing on a driven joint counts for the channel of its drive's effort, all else for the channels that show it.
    """
    found: list[Mismatch] = []
    fewest = min(len(group.repeats) for group in seen.groups)  # whose mean's noise is that of all
    shares: dict[str, float] = {}
    settings = tuned.looked[0].beside.along.settings
    drives = {drive.joint: f"{'current' if drive.unit == 'A' else 'effort'}_{drive.axis}" for drive in settings.drives}
    for group, one, left in zip(seen.groups, tuned.looked, best.innovations, strict=True):
        along = one.beside.along
        rows = one.beside.left.shape[0]
        channels = [*along.observed.channels, *(drives[drive.joint] for drive in along.settings.drives)]
        parts: dict[str | None, Column] = {None: Column({}, {})}
        if best.settings:
            change = column(one.signals, signals_of(tuned, one, best.settings))
            by_joint = {along.joints[joint]: {joint: effort} for joint, effort in change.efforts.items()}
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


def _mismatch(group: Group, one: Looked, white: np.ndarray, left: float) -> Mismatch:
    along, motion = one.beside.along, one.motion
    joints = [along.joints.index(drive.joint) for drive in along.settings.drives]
    begins = tuple((repeat.name, repeat.begin_s) for repeat in group.repeats)
    return Mismatch(begins, along.observed.time, white, left, motion.position[:, joints], motion.speed[:, joints], along.observed.targets)

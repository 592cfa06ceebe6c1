"""Whether controllers and sensors are what the machine file says, before any physics is sought."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from hil.diagnosis.audit.controller import AxisAudit, Measured, audit_controllers
from hil.diagnosis.audit.readings import Fault
from hil.diagnosis.audit.sensors import SensorAudit, audit_sensors
from hil.machine import Machine
from hil.recording import Recording
from hil.simulation.control_laws import controllers_of

GRAVITY = ("as_filed", "unknown", "differs")
"""Of several recordings the gravest counts."""


@dataclass(frozen=True)
class Audit:
    """What recordings show of a machine's controllers and sensors.

    Attributes
    ----------
    machine : Machine
    axes : tuple of AxisAudit
        Of those axes whose command, reference and position were recorded.
    sensors : tuple of SensorAudit
    faults : tuple of Fault
        By which recordings are not what they say; where there are some, nothing else was audited.
    """

    machine: Machine
    axes: tuple[AxisAudit, ...]
    sensors: tuple[SensorAudit, ...]
    faults: tuple[Fault, ...] = ()

    @property
    def has_play(self) -> bool:
        """Whether two encoders of an axis show play between them."""
        return any(each.gap > 0.0 for each in self.sensors)

    @property
    def wrong(self) -> list[str]:
        """What is not as the file says of controllers, and of units and signs of encoders, a sentence each."""
        return [axis.said for axis in self.axes if axis.status == "differs"] + [pair.said for pair in self.sensors if pair.is_wrong]

    def document(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "recordings": [{"recording": each.recording, "channel": each.channel, "said": each.said} for each in self.faults],
            "axes": {axis.axis: _axis(axis) for axis in self.axes},
            "sensors": [
                {key: getattr(each, key) for key in ("first", "second", "gain", "delay_s", "gap", "offset", "status")}
                for each in self.sensors
            ],
        }


def audit(machine: Machine, recordings: Mapping[str, Recording]) -> Audit:
    """Audit the controllers and the pairs of encoders that recordings show; every recording beside the controllers that it names."""
    parts: dict[str, dict[str, Recording]] = {}
    for label, recording in recordings.items():
        parts.setdefault(recording.machine_text, {})[label] = recording
    worst: dict[str, AxisAudit] = {}
    for part in parts.values():
        for one in _controllers(machine, part):
            if one.axis not in worst or GRAVITY.index(one.status) > GRAVITY.index(worst[one.axis].status):
                worst[one.axis] = one
    pairs = audit_sensors(machine, list(recordings.values()))
    return Audit(machine, tuple(worst[axis] for axis in machine.axes if axis in worst), tuple(pairs))


def _controllers(machine: Machine, recordings: Mapping[str, Recording]) -> list[AxisAudit]:
    """Audit controllers by all recordings; where no law gives every command, by each alone: a gain may have changed in between."""
    own = controllers_of(machine, next(iter(recordings.values())))
    found = []
    for one in audit_controllers(own, list(recordings.values())):
        each = {label: audit_controllers(own, [recording]) for label, recording in recordings.items() if one.status == "unknown"}
        alone = {label: by for label, every in each.items() for by in every if by.axis == one.axis and by.status == "differs"}
        said = "; ".join(f"{label}: {by.said}" for label, by in alone.items())
        found.append(replace(next(iter(alone.values())), said=said) if alone else one)
    return found


def _axis(axis: AxisAudit) -> dict[str, Any]:
    measured = {key: _measured(getattr(axis, key)) for key in ("gain", "delay_s", "saturation", "offset", "rate_Hz")}
    sign = None if axis.gain.value is None else (1.0 if axis.gain.value > 0.0 else -1.0)
    return {
        **measured,
        "sign": {"value": sign, "ci95": None, "file": 1.0},
        "replayed_rms": axis.replayed_rms,
        "resolution": axis.resolution,
        "status": axis.status,
    }


def _measured(one: Measured) -> dict[str, Any]:
    return {"value": one.value, "ci95": None if one.ci95 is None else list(one.ci95), "file": one.file}

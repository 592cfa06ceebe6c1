"""Layout of a recording's rows: names and units are fixed before the loop starts, so that a tick only fills slices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.interface import Sample
from hil.bench.signals import Signals
from hil.recording.channels import imu_channels


@dataclass(frozen=True)
class AxisColumns:
    """Name and units of an axis."""

    name: str
    position_unit: str  # "rad" or "m"
    effort_unit: str  # "A", "V", "Nm" or "N"
    command_unit: str  # of the effort, or of a velocity or position

    @property
    def effort_channel(self) -> str:
        """Channel of the effort: `current_<axis>` where the drive is commanded in ampere, `effort_<axis>` otherwise."""
        return f"{'current' if self.effort_unit == 'A' else 'effort'}_{self.name}"


class RowLayout:
    """The columns of one machine's recordings, in contract order.

    Parameters
    ----------
    axes : sequence of AxisColumns
    period_s : float
        Sample period; time is tick number times period.
    imu : str
        Name of the IMU on the bench's line; "" without one.
    bus_imu : str
        Name of the IMU that is a node of the bus; "" without one.
    link, temperature : bool
        Which other optional sensors the machine has.
    observed : sequence of (name, unit)
        Columns of an observer: the last ones, at `RowLayout.observed`.
    """

    def __init__(
        self,
        axes: Sequence[AxisColumns],
        period_s: float,
        *,
        imu: str,
        bus_imu: str = "",
        link: bool,
        temperature: bool,
        observed: Sequence[tuple[str, str]] = (),
    ) -> None:
        self.axes = tuple(axes)
        self.period_s = period_s
        self.channels: list[tuple[str, str]] = [("time", "s")]
        self._groups: dict[str, slice] = {}
        for group, name_of, unit_of in (
            ("reference", lambda a: f"reference_{a.name}", lambda a: a.position_unit),
            ("reference_raw", lambda a: f"reference_raw_{a.name}", lambda a: a.position_unit),
            ("excitation", lambda a: f"excitation_{a.name}", lambda a: a.effort_unit),
            ("feedforward", lambda a: f"feedforward_{a.name}", lambda a: a.effort_unit),
            ("command", lambda a: f"command_{a.name}", lambda a: a.command_unit),
            ("effort", lambda a: a.effort_channel, lambda a: a.effort_unit),
            ("position", lambda a: f"position_{a.name}", lambda a: a.position_unit),
            ("link_position", lambda a: f"link_position_{a.name}", lambda a: a.position_unit),
            ("temperature", lambda a: f"temperature_{a.name}", lambda a: "degC"),
            ("statusword", lambda a: f"statusword_{a.name}", lambda a: ""),
            ("data_age", lambda a: f"data_age_{a.name}", lambda a: "s"),
        ):
            if (group == "link_position" and not link) or (group == "temperature" and not temperature):
                continue
            self._add(group, [(name_of(axis), unit_of(axis)) for axis in self.axes])
        if imu:
            self._add("imu", list(zip(imu_channels(imu), ("m/s^2",) * 3 + ("rad/s",) * 3, strict=True)))
            self._add("imu_time", [("imu_time", "s")])
            self._add("imu_counter", [("imu_counter", "")])
        if bus_imu:
            self._add("bus_imu", list(zip(imu_channels(bus_imu), ("m/s^2",) * 3 + ("rad/s",) * 3, strict=True)))
            self._add("bus_imu_time", [(f"{bus_imu}_time", "s")])
            self._add("bus_imu_counter", [(f"{bus_imu}_counter", "")])
        self._add("sync_lateness", [("sync_lateness", "s")])
        self._add("work_time", [("work_time", "s")])
        self._add("answer_time", [("answer_time", "s")])
        self._add("sensor_marks", [("sensor_marks", "")])
        self._add("observed", list(observed))
        self.observed = self._groups["observed"]

    def _add(self, group: str, channels: list[tuple[str, str]]) -> None:
        self._groups[group] = slice(len(self.channels), len(self.channels) + len(channels))
        self.channels += channels

    @property
    def width(self) -> int:
        """Number of columns."""
        return len(self.channels)

    def fill(
        self,
        row: np.ndarray,
        k: int,
        sample: Sample,
        plan: Signals,
        command: np.ndarray,
        timing_s: tuple[float, float, float],
        marks: int = 0,
    ) -> None:
        """Write tick k into `row` (width,). Missing values are NaN.

        `timing_s`: lateness of the SYNC; work time, from the SYNC until the loop was ready to wait again; and the part of it in which the
        loop waited for the devices' answers. `marks`: a bit per sensor that is not to be believed.
        """
        groups = self._groups
        row[0] = k * self.period_s
        row[groups["reference"]] = plan.reference[k]
        row[groups["reference_raw"]] = plan.reference_raw[k]
        row[groups["excitation"]] = plan.excitation[k]
        row[groups["feedforward"]] = 0.0 if plan.feedforward is None else plan.feedforward[k]
        row[groups["command"]] = command
        row[groups["effort"]] = sample.effort
        row[groups["position"]] = sample.position
        if "link_position" in groups:
            row[groups["link_position"]] = sample.link_position
        if "temperature" in groups:
            row[groups["temperature"]] = sample.temperature_degC
        status = row[groups["statusword"]]
        status[:] = sample.statusword
        status[status < 0.0] = np.nan
        row[groups["data_age"]] = sample.age_s
        if "imu" in groups:
            row[groups["imu"]] = sample.imu
            row[groups["imu_time"]] = sample.imu_time_s
            row[groups["imu_counter"]] = sample.imu_counter if sample.imu_counter >= 0 else np.nan
        if "bus_imu" in groups:  # it samples at SYNC, and has no clock of its own
            row[groups["bus_imu"]] = sample.bus_imu
            has_come = sample.bus_imu_counter >= 0
            row[groups["bus_imu_time"]] = k * self.period_s if has_come else np.nan
            row[groups["bus_imu_counter"]] = sample.bus_imu_counter if has_come else np.nan
        row[groups["sync_lateness"]], row[groups["work_time"]], row[groups["answer_time"]] = timing_s
        row[groups["sensor_marks"]] = marks

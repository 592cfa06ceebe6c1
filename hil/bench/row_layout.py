"""Layout of a recording's rows: names, units and places are fixed before the loop starts, so that a tick only fills a row, compiled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import float64, int64, types, uint8

from controllers.compiled import kept_on_disk
from drivers.interface import Sample
from drivers.records import record_type
from drivers.sample_memory import imus_in, values_in
from hil.bench.signals import Signals
from hil.recording.channels import imu_channels

COLUMNS = record_type(
    *((group, "i8") for group in ("reference", "reference_raw", "excitation", "feedforward", "command", "effort", "position")),
    *((group, "i8") for group in ("link_position", "temperature", "statusword", "data_age", "imu", "bus_imu", "sync_lateness")),
)
"""First column of each group of a row; negative where the machine has none."""

_FILL = types.void(
    *(float64[::1], uint8[::1], uint8[::1]),
    *(types.Array(float64, 2, "A", readonly=True),) * 4,
    types.Array(float64, 1, "A", readonly=True),
    *(int64, float64, float64, int64, int64, float64, float64, float64, int64),
)


@kept_on_disk(_FILL, fastmath=False, error_model="numpy")
def _fill(
    row: np.ndarray,
    columns: np.ndarray,
    sample: np.ndarray,
    reference: np.ndarray,
    reference_raw: np.ndarray,
    excitation: np.ndarray,
    feedforward: np.ndarray,
    command: np.ndarray,
    k: int,
    period_s: float,
    imu_time_s: float,
    imu_counter: int,
    bus_imu_counter: int,
    lateness_s: float,
    work_s: float,
    answer_s: float,
    marks: int,
) -> None:
    """Write tick k into a row; see `RowLayout.fill`."""
    at, values, imus = columns.view(COLUMNS)[0], values_in(sample), imus_in(sample)
    row[0] = k * period_s
    for axis in range(len(values)):
        of_axis = values[axis]
        row[at.reference + axis] = reference[k, axis]
        row[at.reference_raw + axis] = reference_raw[k, axis]
        row[at.excitation + axis] = excitation[k, axis]
        row[at.feedforward + axis] = feedforward[k, axis] if len(feedforward) else 0.0
        row[at.command + axis] = command[axis]
        row[at.effort + axis] = of_axis.effort
        row[at.position + axis] = of_axis.position
        if at.link_position >= 0:
            row[at.link_position + axis] = of_axis.link_position
        if at.temperature >= 0:
            row[at.temperature + axis] = of_axis.temperature_degC
        row[at.statusword + axis] = of_axis.statusword if of_axis.statusword >= 0 else np.nan
        row[at.data_age + axis] = of_axis.age_s
    if at.imu >= 0:
        for channel in range(6):
            row[at.imu + channel] = imus[channel]
        row[at.imu + 6] = imu_time_s
        row[at.imu + 7] = imu_counter if imu_counter >= 0 else np.nan
    if at.bus_imu >= 0:  # it samples at SYNC, and has no clock of its own
        for channel in range(6):
            row[at.bus_imu + channel] = imus[6 + channel]
        row[at.bus_imu + 6] = k * period_s if bus_imu_counter >= 0 else np.nan
        row[at.bus_imu + 7] = bus_imu_counter if bus_imu_counter >= 0 else np.nan
    row[at.sync_lateness] = lateness_s
    row[at.sync_lateness + 1] = work_s
    row[at.sync_lateness + 2] = answer_s
    row[at.sync_lateness + 3] = marks


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
        self._groups: dict[str, int] = {}
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
        self.observed = slice(len(self.channels) - len(observed), len(self.channels))
        self._columns = np.array([tuple(self._groups.get(group, -1) for group in COLUMNS.names or ())], COLUMNS).view(np.uint8)
        self._no_feedforward = np.zeros((0, len(self.axes)))

    def _add(self, group: str, channels: list[tuple[str, str]]) -> None:
        self._groups[group] = len(self.channels)
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
        if sample.axes != len(self.axes):
            raise ValueError(f"a sample of {sample.axes} axes and a row of {len(self.axes)}")
        _fill(
            row,
            self._columns,
            sample.memory,
            plan.reference,
            plan.reference_raw,
            plan.excitation,
            self._no_feedforward if plan.feedforward is None else plan.feedforward,
            command,
            k,
            self.period_s,
            sample.imu_time_s,
            sample.imu_counter,
            sample.bus_imu_counter,
            *timing_s,
            marks,
        )

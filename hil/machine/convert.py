"""A machine file for another sample rate: its text with comments and order kept, and only the numbers changed that hang on the rate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import tomlkit

from controllers.errors import DesignError
from controllers.rediscretise import rediscretised, rediscretised_share
from hil.errors import MachineFileError, UnusableInputError
from hil.machine.machine import Machine
from hil.machine.schema import MachineTable
from hil.machine.schema_judging import ImuJudgingTable

WHOLE = 1e-9
"""Rounding up to which a scaled count is the whole number that it means."""

Where = tuple[str | int, ...]

EVERY_SYNC, SELDOM = 1, 240
"""Transmission types of PDOs that are sent every so many SYNCs (CiA 301, table 72)."""
FEWEST_FROZEN = 2
"""Packets of one value that can be a frozen channel."""
LEAST_AGE = 1.5
"""Packets, of the age at which one is missed: a packet that is in time is no older than one."""


@dataclass(frozen=True)
class Change:
    """One key of the file that was changed; `old` is None where the file had left a default out."""

    key: str
    old: Any
    new: Any


def converted_text(machine: Machine, sample_rate_Hz: float) -> tuple[str, list[Change]]:
    """Return the machine's file for another sample rate, and what was changed.

    Steps of the plant become no longer. Counts of ticks, of SYNCs between two PDOs and of packets keep their time, rounded down and at
    least 1. Times stay, but the age of the IMU's packets grows where it would be less than a packet and a half. `answer_timeout` keeps
    its share of the period. Filters are carried by `controllers.rediscretise`.

    Raises
    ------
    UnusableInputError
        The rate is no positive number.
    MachineFileError
        A section that cannot be carried over: file, key, section and frequency.
    """
    if not (math.isfinite(sample_rate_Hz) and sample_rate_Hz > 0.0):
        raise UnusableInputError(f"--rate {sample_rate_Hz:g}: must be a positive number of Hz, such as 512")
    file = _File(machine, sample_rate_Hz)
    for edit in (_timing, _drives, _controllers, _bus, _imu):
        edit(file)
    return tomlkit.dumps(file.document), file.changes


class _File:
    """The document under edit, the same as checked tables, and both rates."""

    def __init__(self, machine: Machine, rate_Hz: float) -> None:
        self.name = str(machine.path or machine.name)
        self.document = tomlkit.parse(machine.text)
        self.table = MachineTable.model_validate(self.document.unwrap())
        self.old_Hz, self.rate_Hz = machine.sample_rate_Hz, rate_Hz
        self.ratio = rate_Hz / machine.sample_rate_Hz
        self.changes: list[Change] = []

    def put(self, where: Where, value: float) -> None:
        """Set a key, added to its table where it is not there."""
        holder: Any = self.document
        for part in where[:-1]:
            holder = holder[part]
        old = holder.get(where[-1])
        if old != value:
            holder[where[-1]] = value
            self.changes.append(Change(".".join(map(str, where)), old, value))

    def table_of(self, *where: str) -> None:
        """Add tables that are not there yet."""
        holder: Any = self.document
        for part in where:
            if part not in holder:
                holder[part] = tomlkit.table()
            holder = holder[part]

    def scale(self, where: Where, factor: float) -> None:
        """Multiply a number, whatever its unit."""
        value: Any = self.document
        for part in where:
            value = value[part]
        self.put(where, float(f"{value * factor:.9g}"))

    def ticks(self, count: int) -> int:
        """Return as many ticks as take the time that `count` of them took, or the next less; a count above 0 stays so."""
        return max(math.floor(count * self.ratio + WHOLE), min(count, 1))

    def sections(self, where: Where, sections: Sequence[Sequence[float]] | None) -> None:
        """Carry a cascade over, row by row in place: the comments behind the rows stay."""
        if sections is None:
            return
        try:
            carried = rediscretised(np.array(sections), self.old_Hz, self.rate_Hz)
        except DesignError as error:
            raise self.refusal(where, error) from None
        rows: Any = self.document
        for part in where:
            rows = rows[part]
        for row, new in zip(rows, carried, strict=True):
            for place, number in enumerate(new):
                if float(row[place]) != number:
                    row[place] = float(number)
        if not np.array_equal(carried, np.array(sections)):
            self.changes.append(Change(".".join(map(str, where)), [list(row) for row in sections], carried.tolist()))

    def refusal(self, where: Where, error: DesignError) -> MachineFileError:
        """Return the one line of a filter that cannot be carried over."""
        return MachineFileError(f"{self.name}: {'.'.join(map(str, where))}: {error}")


def _timing(file: _File) -> None:
    timing = file.table.timing
    file.put(("timing", timing.key("sample_rate")), file.rate_Hz / (1e3 if timing.unit("sample_rate") == "kHz" else 1.0))
    file.put(("timing", "substeps"), math.ceil(timing.substeps / file.ratio - WHOLE))
    for field in ("overrun_ticks", "stale_ticks"):
        count = getattr(timing, field)
        if file.ticks(count) != count:
            file.put(("timing", field), file.ticks(count))


def _drives(file: _File) -> None:
    for axis, drive in file.table.drives.items():
        if drive.loops is None:
            continue
        where = ("drives", axis, "loops")
        try:
            share = rediscretised_share(drive.loops.speed_filter, file.old_Hz, file.rate_Hz)
        except DesignError as error:
            raise file.refusal((*where, "speed_filter"), error) from None
        if share != drive.loops.speed_filter:
            file.put((*where, "speed_filter"), share)
        file.sections((*where, "torque_sections"), drive.loops.torque_sections)


def _controllers(file: _File) -> None:
    for axis, controller in file.table.controller.items():
        for field in ("position_sections", "reference_sections"):
            file.sections(("controller", axis, field), getattr(controller, field))


def _bus(file: _File) -> None:
    bus = file.table.bus
    if bus is None:
        return
    if bus.answers == "punctual":
        file.scale(("bus", bus.key("answer_timeout")), 1.0 / file.ratio)
    for name, node in bus.nodes.items():
        for kind in ("tpdo", "rpdo"):
            for number, pdo in enumerate(getattr(node, kind)):
                if EVERY_SYNC < pdo.transmission_type <= SELDOM:
                    file.put(("bus", "nodes", name, kind, number, "transmission_type"), min(file.ticks(pdo.transmission_type), SELDOM))


def _imu(file: _File) -> None:
    """Edit the IMU on the bus: its rate where SYNC triggers it, and what is judged of its packets, of which a row holds one at most."""
    imu, judging = None if file.table.bus is None else file.table.bus.imu, file.table.judging
    if imu is None:
        return
    before_s = max(1.0 / imu.rate, 1.0 / file.old_Hz)
    after_s = max(1.0 / (imu.rate * (file.ratio if imu.triggered_by_sync else 1.0)), 1.0 / file.rate_Hz)
    if imu.triggered_by_sync:
        file.scale(("bus", "imu", imu.key("rate")), file.ratio)
    rules = ImuJudgingTable.model_validate({}) if judging is None else judging.imu
    frozen = max(math.floor(rules.frozen_packets * before_s / after_s + WHOLE), FEWEST_FROZEN)
    if frozen != rules.frozen_packets:
        file.table_of("judging", "imu")
        file.put(("judging", "imu", "frozen_packets"), frozen)
    if rules.age is not None and rules.age < LEAST_AGE * after_s:
        file.scale(("judging", "imu", rules.key("age")), LEAST_AGE * after_s / rules.age)

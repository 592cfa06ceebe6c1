"""Faults of the IMU: what it measures, and what of its messages comes through."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from virtual_bus.faults.devices import FaultyImu
from virtual_bus.faults.fault import FaultKind, Parameter, Trial, Values
from virtual_bus.faults.machine import FaultyMachine
from virtual_bus.faults.seam import Undo


def _device(machine: FaultyMachine) -> FaultyImu:
    assert machine.faulty_imu is not None  # the place was checked: the machine has one
    return machine.faulty_imu


def _reads(machine: FaultyMachine, change: Callable[[np.ndarray], np.ndarray]) -> Undo:
    return _device(machine).readings.add("", change)


def silent(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Send nothing."""
    return _device(machine).messages.add("", lambda message: b"")


def garbled(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Send random bytes: a baud rate that does not fit, or interference."""
    numbers = machine.random("imu_garbled")
    return _device(machine).messages.add("", lambda message: numbers.bytes(len(message)))


def damaged(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Damage a share of the messages by one bit, which their check shows."""
    numbers = machine.random("imu_damaged")

    def damage(message: bytes) -> bytes:
        if numbers.random() >= values["share"] or not message:
            return message
        place = int(numbers.integers(len(message)))
        return message[:place] + bytes((message[place] ^ 1 << int(numbers.integers(8)),)) + message[place + 1 :]

    return _device(machine).messages.add("", damage)


def slow(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Send every n-th message only."""
    count = 0

    def thin(message: bytes) -> bytes:
        nonlocal count
        count += 1
        return message if count % int(values["every"]) == 0 else b""

    return _device(machine).messages.add("", thin)


def late(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Send each message some SYNCs late."""
    waiting: list[bytes] = []

    def delay(message: bytes) -> bytes:
        waiting.append(message)
        return waiting.pop(0) if len(waiting) > values["syncs"] else b""

    return _device(machine).messages.add("", delay)


def repeated(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Send one message again and again, counter and time included."""
    held: list[bytes] = []

    def repeat(message: bytes) -> bytes:
        held.append(message)
        del held[1:]
        return held[0]

    return _device(machine).messages.add("", repeat)


def not_a_number(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Read NaN."""
    return _reads(machine, lambda sample: np.full_like(sample, np.nan))


def infinite(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Read infinity."""
    return _reads(machine, lambda sample: np.full_like(sample, np.inf))


def frozen(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Read the sample of one instant for ever; counter and time go on."""
    held: list[np.ndarray] = []

    def stay(sample: np.ndarray) -> np.ndarray:
        held.append(sample.copy())
        del held[1:]
        return held[0]

    return _reads(machine, stay)


def bias_jumps(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Add a bias to all channels of a kind."""
    bias = np.repeat([values["acceleration"], values["rate"]], 3)
    return _reads(machine, lambda sample: sample + bias)


def saturates(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Read the end of the range in one channel."""

    def saturate(sample: np.ndarray) -> np.ndarray:
        changed = sample.copy()
        changed[2] = values["range"]
        return changed

    return _reads(machine, saturate)


def reboots(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Start anew: WakeUp, then the default output."""
    machine.imu_out(_device(machine).power_on())
    return lambda: None


SYNCS = Parameter("syncs", "", 2.0, 1.0, 1000.0, "by which they are late", whole=True)
KINDS = (
    FaultKind("imu_silent", "The IMU sends nothing.", "IMU", "imu", silent, trials=(Trial(), Trial(for_s=0.2), Trial("start"))),
    FaultKind("imu_garbled", "The IMU sends random bytes.", "IMU", "imu", garbled),
    FaultKind("imu_damaged", "A share of the IMU's messages is damaged.", "IMU", "imu", damaged,
              (Parameter("share", "", 0.2, 0.0, 1.0, "of the messages"),)),
    FaultKind("imu_slow", "The IMU sends every n-th message only.", "IMU", "imu", slow,
              (Parameter("every", "", 2.0, 2.0, 1e6, "message that comes", whole=True),)),
    FaultKind("imu_late", "The IMU's messages come some SYNCs late.", "IMU", "imu", late, (SYNCS,)),
    FaultKind("imu_repeats", "The IMU sends one message again and again.", "IMU", "imu", repeated),
    FaultKind("imu_nan", "The IMU reads NaN.", "IMU", "imu", not_a_number),
    FaultKind("imu_infinite", "The IMU reads infinity.", "IMU", "imu", infinite),
    FaultKind("imu_frozen", "The IMU reads the sample of one instant for ever; its counter goes on.", "IMU", "imu", frozen),
    FaultKind("imu_bias_jumps", "The IMU's bias jumps.", "IMU", "imu", bias_jumps,
              (Parameter("acceleration", "m/s^2", 2.0, -1e3, 1e3, "added to the specific force"),
               Parameter("rate", "rad/s", 0.2, -1e3, 1e3, "added to the angular rate"))),
    FaultKind("imu_saturates", "One channel of the IMU reads the end of its range.", "IMU", "imu", saturates,
              (Parameter("range", "m/s^2", 50.0, -1e3, 1e3, "what it reads"),)),
    FaultKind("imu_reboots", "The IMU starts anew: its configuration is lost.", "IMU", "imu", reboots),
)  # fmt: skip

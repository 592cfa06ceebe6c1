"""Faults of the I/O device: what it refuses, how it answers, and what its inputs for hold-to-run and door show."""

from __future__ import annotations

from drivers.modbus.registers import ExceptionCode, FunctionCode
from virtual_bus.faults.devices import FaultyIo
from virtual_bus.faults.fault import FaultKind, Parameter, Trial, Values
from virtual_bus.faults.machine import FaultyMachine
from virtual_bus.faults.seam import Undo

_WRITES = (FunctionCode.WRITE_SINGLE_COIL, FunctionCode.WRITE_MULTIPLE_COILS)
CODE = Parameter("code", "", float(ExceptionCode.SERVER_DEVICE_FAILURE), 1.0, 255.0, "Modbus exception code", whole=True)
SWEEP_AND_STOP = (Trial(), Trial("stop"))


def refuses_writes(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Answer every write with an exception."""
    return _device(machine).refusals.add("", lambda pdu: _exception(pdu, values) if pdu[0] in _WRITES else None)


def answers_exceptions(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Answer everything with an exception."""
    return _device(machine).refusals.add("", lambda pdu: _exception(pdu, values))


def ignores_writes(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Acknowledge a write and do nothing: the output stage has lost its supply's enable."""

    def acknowledge(pdu: bytes) -> bytes | None:
        return pdu[:5] if pdu[0] in _WRITES else None

    return _device(machine).refusals.add("", acknowledge)


def vanishes(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Close every connection."""
    device = _device(machine)
    device.hangs_up = True

    def undo() -> None:
        device.hangs_up = False

    return undo


def hangs(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Take requests and answer none; the outputs stay as they are."""
    device = _device(machine)
    device.hangs = True

    def undo() -> None:
        device.hangs = False

    return undo


def answers_late(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Send each answer with the request after the one it belongs to."""
    before = b""

    def late(answer: bytes) -> bytes:
        nonlocal before
        sent, before = before, answer
        return sent

    return _device(machine).answers.add("", late)


def answers_garbled(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Send random bytes for an answer."""
    numbers = machine.random("io_answers_garbled")
    return _device(machine).answers.add("", lambda answer: numbers.bytes(len(answer)))


def inputs_frozen(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Go on answering with the inputs of this instant: the bus coupler has lost its terminals."""
    device = _device(machine)
    frozen = list(device.discrete_inputs)

    def hold() -> None:
        for number in device.layout.inputs:
            device.discrete_inputs[number] = frozen[number]

    return machine.samples.add("", hold)


def outputs_off(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Switch all coils off by itself, again and again: the device has started anew."""
    device = _device(machine)

    def off() -> None:
        device.coils[:] = [False] * len(device.coils)

    return machine.samples.add("", off)


def hold_to_run_released(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Release the operator's switch."""
    device = _device(machine)
    device.set_hold_to_run(False)
    return lambda: device.set_hold_to_run(True)


def hold_to_run_flickers(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Press and release the switch in turns."""
    device, began_s = _device(machine), machine.time_s

    def flicker() -> None:
        device.set_hold_to_run(int((machine.time_s - began_s) / (0.5 * values["period"])) % 2 == 1)

    undo = machine.samples.add("", flicker)

    def pressed() -> None:
        undo()
        device.set_hold_to_run(True)

    return pressed


def hold_to_run_stuck(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Keep the first contact of the switch as if pressed, whatever the operator does."""
    device = _device(machine)

    def stick() -> None:
        device.discrete_inputs[device.layout.hold_to_run_input] = True

    return machine.samples.add("", stick)


def door_opened(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Open the door's contact."""
    device = _device(machine)
    device.set_door(False)
    return lambda: device.set_door(True)


def _device(machine: FaultyMachine) -> FaultyIo:
    assert machine.faulty_io is not None  # the place was checked: the machine has one
    return machine.faulty_io


def _exception(pdu: bytes, values: Values) -> bytes:
    return bytes((pdu[0] | 0x80, int(values["code"])))


KINDS = (
    FaultKind("io_refuses_writes", "The I/O answers every write with a Modbus exception; it goes on answering reads.", "I/O", "io",
              refuses_writes, (CODE,), (*SWEEP_AND_STOP, Trial("start")), budget="io_silent"),
    FaultKind("io_answers_exceptions", "The I/O answers everything with a Modbus exception.", "I/O", "io", answers_exceptions, (CODE,),
              (Trial(), Trial("start")), budget="io_silent"),
    FaultKind("io_ignores_writes", "The I/O acknowledges writes and does not work its outputs.", "I/O", "io", ignores_writes,
              trials=(*SWEEP_AND_STOP, Trial("start")), budget="io_silent"),
    FaultKind("io_vanishes", "The I/O closes its connections and takes none; its outputs stay as they are.", "I/O", "io", vanishes,
              trials=(Trial(), Trial("start")), budget="io_silent"),
    FaultKind("io_hangs", "The I/O takes requests and answers none; its outputs stay as they are.", "I/O", "io", hangs, budget="io_silent"),
    FaultKind("io_answers_late", "Each answer of the I/O comes with the next request.", "I/O", "io", answers_late, budget="io_silent"),
    FaultKind("io_answers_garbled", "The I/O's answers are random bytes.", "I/O", "io", answers_garbled, budget="io_silent"),
    FaultKind("io_inputs_frozen", "The I/O goes on answering with the inputs of one instant.", "I/O", "io", inputs_frozen,
              trials=SWEEP_AND_STOP, budget="io_silent"),
    FaultKind("io_outputs_off", "The I/O switches its outputs off by itself.", "I/O", "io", outputs_off, budget="io_silent"),
    FaultKind("hold_to_run_released", "The operator's hold-to-run switch is released.", "I/O", "io", hold_to_run_released,
              trials=(Trial(), Trial("settled"), Trial("homing"), Trial("first move"))),
    FaultKind("hold_to_run_flickers", "Hold-to-run is released and pressed in turns.", "I/O", "io", hold_to_run_flickers,
              (Parameter("period", "s", 0.1, 0.005, 10.0, "from one release to the next"),), (Trial(for_s=0.5),)),
    FaultKind("hold_to_run_stuck", "The first contact of hold-to-run shows pressed whatever the operator does.", "I/O", "io",
              hold_to_run_stuck, trials=(Trial("stop"),)),
    FaultKind("door_opened", "The door's contact opens.", "I/O", "io", door_opened),
)  # fmt: skip

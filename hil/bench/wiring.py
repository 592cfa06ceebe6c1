"""Connection of the drivers to a bus URL: to an emulated machine in this process, or to a bus outside it."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite, nan

import can
import numpy as np

from drivers.canopen.heartbeat_consumer import refuse_second_bench
from drivers.canopen.network import PolledNetwork
from drivers.canopen.stopping import Attendant
from drivers.errors import BusError, BusUnavailableError
from drivers.events import Events
from drivers.interface import Clock, Sample
from drivers.machine_link import CanMachine
from drivers.modbus.io import Io, IoDriver
from drivers.modbus.io_process import IoProcess
from drivers.modbus.transport import InProcessTransport
from drivers.serial.imu import ImuDriver
from drivers.serial.stream import open_stream
from drivers.settings import BusSettings
from drivers.supervisor_link.in_process import SupervisorInProcess, SupervisorLink
from drivers.supervisor_link.process import SupervisorProcess
from hil.bench.asking import stop_socket
from hil.bench.attendant import LockstepAttendant, Operator
from hil.bench.clock import ANSWERS_AWAKE_S, LockstepClock, WallClock
from hil.bench.compiled_supervising import CompiledSupervisor
from hil.bench.notice import noticed
from hil.bench.options import BenchOptions
from hil.bench.signals import StopRequest
from hil.emulated.card import find
from hil.emulated.machine import build_emulated, opened_bus
from hil.emulated.truth import TruthLog
from hil.errors import LoopAbortedError, UnusableInputError
from hil.machine import Machine
from hil.processes.real_time import FIFO_PRIORITY
from virtual_bus.faults.machine import FaultyMachine
from virtual_bus.lockstep import LockstepBus, imu_line, io_line

ABOVE_THE_LOOP = FIFO_PRIORITY + 1
"""Priority of the supervisor: a loop that takes all time of a processor must not keep it from judging."""

REST_AT_MOST_S = 20.0
"""Longest time for which a machine with faults is watched after its last SYNC: an arm that swings free on its bearings alone comes to rest
within it, or is not coming to rest."""


class HeedingMachine(CanMachine):
    """A machine that obeys a stop request also in the ticks it makes by itself: booting, homing, brakes."""

    def __init__(
        self,
        stop_request: StopRequest,
        settings: BusSettings,
        bus: can.BusABC,
        clock: Clock,
        imu: ImuDriver | None,
        io: Io | None,
        attendant: Attendant,
        supervisor: SupervisorLink,
    ) -> None:
        super().__init__(settings, bus, clock, imu, io, attendant)
        self._supervisor = supervisor
        self.troubles: list[str] = []  # errors of all stops since the last start; a repeated stop does not repeat them
        self.events = Events(clock.now)  # of the present session
        self._stop_began: int | None = None  # at this tick
        self._stop_request = stop_request

    def start(self) -> None:
        """Start as `CanMachine` does."""
        self.troubles, self._stop_began = [], None
        self._supervisor.begin()
        super().start()

    def resume_ticks(self) -> None:
        """Start the ticks as `CanMachine` does, and tell the supervisor when."""
        super().resume_ticks()
        if not self.settings.sync_producer:
            self._supervisor.ticks_begin()

    def close(self) -> None:
        """Close as `CanMachine` does, and end the supervisor's session."""
        super().close()
        self._supervisor.end()

    def stop(self) -> None:
        """Stop as `CanMachine` does; errors are kept in `troubles`, and how each axis ended in `events`."""
        before, began = self.rests, self.syncs
        super().stop()
        self._stop_began = began if self.rests is not before else self._stop_began
        for rest in self.rests if self.rests is not before else ():
            what = "axis stopped" if rest.safe else "axis not proven at rest"
            took = {step.replace(" ", "_") + "_s": seconds for step, seconds in rest.steps}
            if isfinite(rest.stood_s):
                took["standstill_s"] = rest.stood_s
            self.events.add("drivers", what, axis=rest.axis, seen=rest.words, **took)
        self.troubles += [trouble for trouble in self.stop_trouble if trouble not in self.troubles]

    @property
    def since_stop_s(self) -> float:
        """Ticks since the last stop began, in seconds; NaN where there was none."""
        return nan if self._stop_began is None else (self.syncs - self._stop_began) * self.period_s

    @property
    def standstill(self) -> str:
        """How long after its beginning the last stop brought the axes to a standstill, as seen, in words; "" where not all are safe."""
        stood = [rest.stood_s for rest in self.rests]
        if not stood or not all(rest.safe and isfinite(rest.stood_s) for rest in self.rests):
            return ""
        if not any(stood):
            within = " or ".join(dict.fromkeys(rest.within for rest in self.rests))
            return f"no encoder moved by more than {within} after the stop began"
        each = ", ".join(f"{rest.axis} {f'{rest.stood_s:.2f} s' if rest.stood_s else f'within {rest.within}'}" for rest in self.rests)
        return f"standstill {max(stood):.2f} s after the stop began" + (f" ({each})" if len(stood) > 1 else "")

    def exchange(self, command: np.ndarray) -> Sample:
        """Make one tick; after a stop request stop the motors instead and raise LoopAbortedError with its reason."""
        if self._stop_request.reason:
            self.events.add("operator", "stop asked", reason=self._stop_request.reason)
            self.stop()
            raise LoopAbortedError(f"{self._stop_request.reason}; {self.outcome}")
        sample = super().exchange(command)
        if (trouble := self._supervisor.trouble()) and not self.stopping:
            self.events.add("supervisor", "stop asked", reason=trouble)
            self.stop()
            raise LoopAbortedError(f"{trouble}; {self.outcome}")
        return sample


@dataclass
class Wiring:
    """A machine link and the clock it ticks by; `emulated` where an emulator of this host serves the bus."""

    link: HeedingMachine
    clock: LockstepClock | WallClock
    lockstep: bool
    emulated: bool
    truth: TruthLog | None = None
    faulty: FaultyMachine | None = None

    def start_truth(self) -> None:
        """Begin truth rows with the next SYNC."""
        if self.truth is not None:
            self.truth.recording = True
        if self.faulty is not None:
            self.faulty.recording = True

    def pause_truth(self) -> None:
        """End truth rows; of a machine with faults they go on, until it is at rest."""
        if self.faulty is not None:
            self.faulty.recording = False
        elif self.truth is not None:
            self.truth.recording = False


@contextlib.contextmanager
def lockstep_wiring(machine: Machine, options: BenchOptions, start_pose: np.ndarray | None, stop_request: StopRequest) -> Iterator[Wiring]:
    """Build the emulated machine in this process, standing at `start_pose` (n_axes,), and its drivers on virtual time."""
    settings = machine.bus
    assert settings is not None
    with contextlib.ExitStack() as stack:
        truth = None
        if options.truth is not None:
            truth = stack.enter_context(contextlib.closing(TruthLog(options.truth, (options.emulated or machine).plant.tree.joints)))
            truth.recording = False
        emulated = build_emulated(
            options.emulated or machine,
            start_pose,
            seed=options.seed,
            noise=options.noise,
            truth=truth,
            faults=options.faults,
            quirks=options.quirks,
            motion=options.motion,
        )
        log = stack.enter_context(options.frame_log.open("w", encoding="utf-8")) if options.frame_log is not None else None
        bus = LockstepBus(emulated, log)
        stack.callback(bus.shutdown)
        faulty = emulated if isinstance(emulated, FaultyMachine) else None
        if faulty is not None:
            stack.callback(options.events.extend, faulty.schedule.events)
            stack.callback(faulty.let_rest, bus.pass_time, REST_AT_MOST_S)
        supervisor = SupervisorInProcess(settings, lambda: bus.time_s, bus.send_frame, CompiledSupervisor(settings))
        bus.tap(supervisor.heard, supervisor.take)
        imu = ImuDriver(settings.imu, imu_line(emulated)) if settings.imu is not None else None
        io: Io | None = None
        if settings.io is not None:
            line = io_line(emulated)

            def serve(request: bytes) -> bytes:
                line.write(request)
                return line.read()

            io = IoDriver(settings.io, InProcessTransport(serve), machine.axes, supervisor.refresh)
        clock = LockstepClock(bus.pass_time, lambda: bus.time_s, paced=options.paced)
        link = HeedingMachine(stop_request, settings, bus, clock, imu, io, LockstepAttendant(), supervisor)
        yield Wiring(link, clock, True, True, truth, faulty)


@contextlib.contextmanager
def wall_wiring(machine: Machine, options: BenchOptions, stop_request: StopRequest) -> Iterator[Wiring]:
    """Connect to a machine on a bus outside this process, real or emulated, on wall time.

    Raises
    ------
    BusUnavailableError
        The bus, serial port or I/O does not exist, or the address of IMU or I/O is unknown.
    DuplicateNodeError
        Another bench runs on this bus; neither its IMU nor its I/O was touched.
    UnusableInputError
        An option works only in lockstep.
    """
    settings = machine.bus
    assert settings is not None
    if options.emulated is not None or not options.noise:
        what = "--effects" if options.emulated is not None else "--no-noise"
        raise UnusableInputError(f"{what}: only an emulated machine can be told; give it to `isocenter emulate`, or run on lockstep:")
    if options.quirks:
        raise UnusableInputError("--quirk: only an emulated machine can have them; give them to `isocenter emulate`, or run on lockstep:")
    if options.faults or options.motion is not None:
        raise UnusableInputError("--faults: only an emulated machine can have them; give them to `isocenter emulate`, or run on lockstep:")
    if options.truth is not None:
        raise UnusableInputError("--truth: only an emulator knows the truth; give it to `isocenter emulate`, or run on lockstep:")
    if options.frame_log is not None:
        raise UnusableInputError(
            f"--frame-log: the loop writes none on a real bus; record {options.bus_url} beside it: candump -l, python -m can.logger"
        )
    with contextlib.ExitStack() as stack:
        bus = stack.enter_context(opened_bus(options.bus_url, settings.bitrate_bit_s))
        settings = _with_ports(machine, settings, options)
        clock = WallClock(waits=machine.waits_on_overrun, awake_s=ANSWERS_AWAKE_S if options.real_time else 0.0)
        refuse_second_bench(PolledNetwork(bus, clock), settings.master_node_id, settings.master_heartbeat_period_s)
        supervisor = SupervisorProcess(
            settings, options.bus_url, ABOVE_THE_LOOP if options.real_time else 0, stop_socket(options.bus_url, make=True)
        )
        stack.callback(supervisor.close)
        bus = supervisor.tapped(bus)
        imu = None
        if settings.imu is not None:
            stream = stack.enter_context(contextlib.closing(open_stream(settings.imu.device, settings.imu.baud)))
            imu = ImuDriver(settings.imu, stream)
        io = None
        if settings.io is not None:
            io = stack.enter_context(_polling(IoProcess(settings.io, machine.axes, supervisor.memory_name)))
        supervisor.start(io.memory_name if io is not None else "")
        stack.enter_context(noticed(options.bus_url, io.memory_name if io is not None else ""))
        link = HeedingMachine(stop_request, settings, bus, clock, imu, io, Operator(), supervisor)
        if options.real_time:
            clock.rehearsals.append(link.rehearse)
        yield Wiring(link, clock, False, find(options.bus_url) is not None)


@contextlib.contextmanager
def _polling(io: IoProcess) -> Iterator[IoProcess]:
    """Poll the I/O for the length of the block; brakes that may still be open raise BusError, or add a note to another error."""
    try:
        io.start()
        yield io
    except BaseException as error:
        io.close()
        if io.trouble:
            error.add_note(io.trouble)
        raise
    io.close()
    if io.trouble:
        raise BusError(io.trouble)


def _with_ports(machine: Machine, settings: BusSettings, options: BenchOptions) -> BusSettings:
    """Return settings with the IMU's device and the I/O's URL, from the command line, the machine file, or an emulator on this host."""
    card = find(options.bus_url)
    if settings.imu is not None:
        device = options.imu_device or settings.imu.device or (card.imu_device if card else "")
        if not device:
            raise _nowhere(machine, options, "IMU", "[bus.imu] device", "--imu DEVICE")
        settings = dataclasses.replace(settings, imu=dataclasses.replace(settings.imu, device=device))
    if settings.io is not None:
        url = options.io_url or settings.io.url or (card.io_url if card else "")
        if not url:
            raise _nowhere(machine, options, "I/O", "[bus.io] url", "--io URL")
        settings = dataclasses.replace(settings, io=dataclasses.replace(settings.io, url=url))
    return settings


def _nowhere(machine: Machine, options: BenchOptions, what: str, key: str, option: str) -> BusUnavailableError:
    return BusUnavailableError(
        f"{machine.name} on {options.bus_url}: nobody says where its {what} is; "
        f"start `isocenter emulate` on this bus, set {key} or give {option}"
    )

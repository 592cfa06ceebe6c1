"""Assembly of the bench: from a machine and a bus URL to a bench at rest."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from drivers.events import Events
from drivers.judging.judge import SensorJudge
from drivers.modbus.transport import parse_io_url
from hil.bench.bench import Bench
from hil.bench.clock import WallClock
from hil.bench.compiled_judging import averaged_at_once, judged_at_once, watched_at_once
from hil.bench.control import Control
from hil.bench.holding import with_holding_efforts
from hil.bench.judging import judging_of
from hil.bench.loop import SampleLoop
from hil.bench.options import BenchOptions
from hil.bench.row_layout import AxisColumns, RowLayout
from hil.bench.signals import StopRequest
from hil.bench.start_pose import standing
from hil.bench.stop_signals import stopping_on_signals
from hil.bench.wiring import HeedingMachine, Wiring, lockstep_wiring, wall_wiring
from hil.errors import UnusableInputError
from hil.experiments import Plan
from hil.machine import Machine
from hil.observing.live import LiveObserver
from hil.processes.real_time import Scheduling
from virtual_bus.physics import Physics


@contextlib.contextmanager
def open_bench(
    machine: Machine,
    options: BenchOptions,
    start_pose: np.ndarray | None = None,
    observer: LiveObserver | None = None,
    stop_request: StopRequest | None = None,
) -> Iterator[Bench]:
    """Open the bench: find a machine on its bus, at rest.

    Parameters
    ----------
    machine : Machine
    options : BenchOptions
    start_pose : (n_axes,) array, optional
        In lockstep, the pose of the emulated machine when it is switched on.
    observer : LiveObserver, optional
        Watches every recorded row.
    stop_request : StopRequest, optional
        Takes the request of a signal to stop; for a caller who wants to know of it.

    Raises
    ------
    UnusableInputError
        The machine file has no bus or no controller.
    DriverError
        The bus is missing, or a device is absent, wrong or at fault.
    """
    if machine.bus is None:
        raise UnusableInputError(f"{machine.name}: its file has no [bus], so it can be simulated, compared and diagnosed, not run")
    if not machine.controllers:
        raise UnusableInputError(f"{machine.name}: its file has no [controller], so its loop cannot be closed")
    for url in (options.io_url, "" if machine.bus.io is None else machine.bus.io.url):
        if url:
            parse_io_url(url)  # a typo is refused in lockstep as on a wire
    model = Physics(machine.plant, noise=False)
    machine = with_holding_efforts(machine, model)
    assert machine.bus is not None
    lockstep = options.bus_url.startswith("lockstep:")
    stop_request = StopRequest() if stop_request is None else stop_request
    links: list[HeedingMachine] = []
    with contextlib.ExitStack() as stack:
        stack.enter_context(stopping_on_signals(stop_request, lambda: any(link.stopping for link in links)))
        wiring = stack.enter_context(
            lockstep_wiring(machine, options, start_pose, stop_request) if lockstep else wall_wiring(machine, options, stop_request)
        )
        links.append(wiring.link)
        wiring.link.watch.law = watched_at_once
        io = machine.bus.io
        judging = judging_of(machine, model, noise=options.noise)
        judge = SensorJudge(judging, 1.0 / machine.sample_rate_Hz, _noticing(wiring.link.events), judged_at_once, averaged_at_once)
        loop = SampleLoop(
            wiring.link,
            wiring.clock,
            Control(machine.controllers, machine.commands, wiring.link.lead_to, wiring.link.takes_effort),
            machine.limits,
            row_layout(machine, () if observer is None else observer.channels),
            guard_io=io is not None,
            io_stale_s=io.stale_after_s if io is not None else np.inf,
            overrun_ticks=machine.overrun_ticks,
            stale_ticks=machine.stale_ticks,
            braked=[wiring.link.has_brake(axis) for axis in range(len(machine.axes))],
            timed=not lockstep,
            stop_request=stop_request,
            watch=wiring.link.watch.check,
            observer=observer,
            judge=judge,
            events=wiring.link.events,
        )
        pose = _look(machine, model, wiring)
        if isinstance(wiring.clock, WallClock) and options.real_time:
            wiring.clock.has_more_to_rehearse = judge.has_to_rehearse
            wiring.clock.rehearsals.insert(0, judge.rehearse)  # what is warmed last is warmest: the frames
            if observer is not None:
                wiring.clock.rehearsals.append(observer.rehearse)
        if observer is not None and isinstance(wiring.clock, WallClock):
            stack.enter_context(observer.shown(options.bus_url))  # not before a second bench has been refused
        yield Bench(machine, options, wiring, loop, model, Scheduling("default scheduler", False), pose, observer=observer)


def _noticing(events: Events) -> Callable[[float, str, str, str], None]:
    """Return the function that tells the audit trail what was found of a sensor."""

    def notice(row_time_s: float, sensor: str, check: str, says: str) -> None:
        if says:
            events.add("loop", "sensor judged", sensor=sensor, check=check, says=says, row_time_s=row_time_s)
        else:
            events.add("loop", "sensor recovered", sensor=sensor, check=check, row_time_s=row_time_s)

    return notice


def _look(machine: Machine, model: Physics, wiring: Wiring) -> np.ndarray:
    """Return the machine's position (n_axes,) before anything is planned: start the nodes, read them, and reset them."""
    try:
        wiring.link.start()
        return standing(machine, model, wiring.link.exchange(np.zeros(len(machine.axes))))[0]
    finally:
        wiring.link.close()


def row_layout(machine: Machine, observed: Sequence[tuple[str, str]] = ()) -> RowLayout:
    """Return the columns of this machine's recordings, with those of an observer."""
    plant = machine.plant
    return RowLayout(
        [AxisColumns(units.axis, units.position, units.effort, machine.command_unit(axis)) for axis, units in enumerate(machine.units)],
        1.0 / machine.sample_rate_Hz,
        imu=machine.line_imu,
        bus_imu=machine.bus_imu,
        link=any(encoder.channel.startswith("link_") for encoder in plant.encoders),
        temperature=machine.bus is not None and machine.bus.io is not None and bool(machine.bus.io.temperature_registers),
        observed=observed,
    )


def recording_paths(out: Path, plans: Sequence[Plan]) -> list[Path]:
    """Return one path per plan: `out` for one, `<stem>_r1_e2<suffix>` by realisation and experiment for more (counted from 1)."""
    if len(plans) == 1:
        return [out]
    return [
        out.with_name(f"{out.stem}_r{plan.metadata['realisation'] + 1}_e{plan.metadata['experiment'] + 1}{out.suffix}") for plan in plans
    ]

"""The whole examination: checks, wake-ups, a trial of the loop, and what they predict."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drivers.bus_url import BusUrl, parse_bus_url
from drivers.errors import DriverError
from drivers.modbus.transport import parse_io_url
from hil.bench.open import row_layout
from hil.bench.timing import LoopTiming
from hil.doctor import computer, software, storage, wire
from hil.doctor.finding import LEVELS, Finding, Level, unknown
from hil.doctor.tail import BLOCK_S, HORIZON_S, LEAST_BLOCKS, Prediction, missed_ticks, predict
from hil.doctor.trial import tick_times, trial, wake_ups
from hil.errors import BenchError, UnusableInputError
from hil.machine import Machine
from hil.machine.bus_load import sync_answer_s
from hil.processes.real_time import real_time

LISTENED_S = 1.0
WAKE_UP_SHARE = 0.25
"""Length of the measurement without a bus, of the trial's: nothing is foretold from it."""
GOOD_SHARE = 0.25
"""Share of the period within which 99.9 % of the ticks should be done: 1 ms at 256 Hz."""
GOOD_WAKE_UP_SHARE = 0.1
BUSY = "nothing was measured, so as not to disturb it; end it and ask again"
WITHOUT_BIT_RATE = ("udp_multicast",)
MICROSECONDS = 1e6
HOW_OFTEN = "nine times of ten if the computer goes on like this"
SUSPECTS = ("kernel", "scheduler", "locked memory", "processors", "frequency governor", "clock source", "load", "swap", "stolen time")
"""Checks whose findings can explain late ticks."""

Say = Callable[[str], None]


@dataclass(frozen=True)
class Examination:
    """All findings, in order; the prediction is None where nothing was measured."""

    findings: tuple[Finding, ...]
    prediction: Prediction | None
    wake_up_us: dict[str, float] | None
    trial: dict[str, float] | None  # as `timing` of a recording
    answer_from: str  # "measured over udp:", or "computed from the bit rate"

    def of(self, level: Level) -> list[Finding]:
        """Return the findings of a level."""
        return [finding for finding in self.findings if finding.level == level]

    def sentence(self, machine: Machine) -> str:
        """Return the answer in a sentence: yes, no, or that nothing was measured."""
        loop = f"the loop of {machine.name} at {machine.sample_rate_Hz:g} Hz"
        counts = ", ".join(f"{len(self.of(level))} {level}" for level in LEVELS)
        if bad := self.of("bad"):
            return f"No: this computer does not run {loop}, or not for long: {bad[0].check}: {bad[0].found} ({counts})"
        if self.trial is None:
            return f"Not known: {loop} was not tried ({counts})"
        look = self.of("look")
        but = f"; better with {', '.join(dict.fromkeys(finding.check for finding in look))} mended" if look else ""
        return f"Yes: this computer runs {loop}{but} ({counts})"


def examine(machine: Machine, bus_url: str, seconds: float, folder: Path, say: Say, root: Path = Path("/")) -> Examination:
    """Examine this computer for a machine.

    Parameters
    ----------
    machine : Machine
    bus_url : str
        It is not opened, and nothing is sent on it.
    seconds : float
        Of the loop's trial; wake-ups take `WAKE_UP_SHARE` of it.
    folder : Path
        Where recordings would go.
    say : callable
        Takes what is being done, in words.
    root : Path
        Of the trees /proc and /sys.

    Raises
    ------
    UnusableInputError
        The machine's loop cannot be run, or the bus is no bus between processes.
    BusUnavailableError
        The bus URL is wrong.
    """
    bus = parse_bus_url(bus_url)
    if bus.interface in ("lockstep", "virtual"):
        raise UnusableInputError(f"{bus_url}: nothing is late on a bus in one process; give the machine's bus, or udp:")
    if machine.bus is None or not machine.controllers:
        raise UnusableInputError(f"{machine.name}: its file has no [bus] or no [controller], so its loop cannot be run")
    details = wire.link_details(str(bus.channel)) if bus.interface == "socketcan" else None
    real_bus = bus.interface not in WITHOUT_BIT_RATE and not wire.is_virtual(details)
    busy = _busy(bus, root)
    findings = [*_settings(machine, real_bus, folder, root, idle=not busy), *_wires(machine, bus, details, root)]
    if busy:
        return Examination((*findings, Finding("look", "in use", busy, BUSY)), None, None, None, "")
    times = computer.processor_times(root)
    say(f"wake-ups for {WAKE_UP_SHARE * seconds:g} s")
    late = wake_ups(1.0 / machine.sample_rate_Hz, WAKE_UP_SHARE * seconds)
    findings.append(_wake_up_finding(late, 1.0 / machine.sample_rate_Hz))
    wake_up_us = _percentiles_us(late)
    try:
        timing = trial(machine, seconds, say)
    except UnusableInputError:
        raise
    except (BenchError, DriverError) as error:
        findings.append(Finding("bad", "trial", f"the loop did not run to its end: {error}", "mend that, then what is said above"))
        findings.append(computer.stolen(times, computer.processor_times(root)))
        return Examination(tuple(findings), None, wake_up_us, None, "")
    findings.append(computer.stolen(times, computer.processor_times(root)))
    answer_s = sync_answer_s(machine.bus) if real_bus else None
    if answer_s is not None:
        findings.append(_answers(answer_s, machine))
    tick_s = tick_times(timing, answer_s)
    try:
        prediction = predict(tick_s, 1.0 / machine.sample_rate_Hz)
    except ValueError:
        found = f"{timing.missed} of {timing.missed + timing.ticks} ticks were missed, too many to foretell anything"
        findings.append(Finding("bad", "trial", found, "end other work on this computer, and mend what is said above"))
        return Examination(tuple(findings), None, wake_up_us, timing.summary(), "")
    findings.append(_parts(timing))
    suspects = [finding.check for finding in findings if finding.level in ("look", "bad") and finding.check in SUSPECTS]
    findings += predicted(prediction, int(missed_ticks(tick_s, prediction.period_s).max()), machine.overrun_ticks, suspects)
    if timing.unanswered:
        found = f"{timing.unanswered} of {timing.ticks} ticks were not answered in time"
        findings.append(Finding("look", "answers", found, "the emulated machine was held up: end other work on this computer"))
    where = "measured over udp:" if answer_s is None else "computed from the bit rate"
    return Examination(tuple(findings), prediction, wake_up_us, timing.summary(), where)


def least_seconds(machine: Machine) -> float:
    """Return the shortest trial [s]: half of its ticks suffice for a prediction."""
    return 2.0 * LEAST_BLOCKS * max(BLOCK_S, 1.0 / machine.sample_rate_Hz)


def predicted(prediction: Prediction, most_at_once: int, overrun_ticks: int, suspects: Sequence[str] = ()) -> Iterator[Finding]:
    """Say what a prediction means for a machine that bears so many lost ticks at once; `suspects` are checks that may be to blame."""
    mend = f"begin with {', '.join(suspects)}" if suspects else "end other work, try a PREEMPT_RT kernel or a faster computer"
    period_us = MICROSECONDS * prediction.period_s
    times = [MICROSECONDS * value for value in (prediction.p50_s, prediction.p99_s, prediction.p999_s, prediction.max_s)]
    least, most = (MICROSECONDS * value for value in (prediction.p999_least_s, prediction.p999_most_s))
    found = "p50 {:.0f}, p99 {:.0f}, p99.9 {:.0f}, max {:.0f} us".format(*times)
    found += f" of {period_us:.0f} us, {prediction.ticks} ticks; "
    found += f"p99.9 of the {HORIZON_S / 60.0:g} minutes after it {least:.0f} to {most:.0f} us, {HOW_OFTEN}"
    if prediction.p999_s <= GOOD_SHARE * prediction.period_s:
        yield Finding("ok", "whole tick", found)
    else:
        advice = f"p99.9 of at most {GOOD_SHARE * period_us:.0f} us; {mend}"
        yield Finding("bad" if prediction.p999_s > prediction.period_s else "look", "whole tick", found, advice)
    expected = f"{_count(prediction.expected_missed)} expected in {HORIZON_S / 60.0:g} minutes (block maxima)"
    interval = f"between {_count(prediction.least_missed)} and {_count(prediction.most_missed)} {HOW_OFTEN}"
    found = f"{prediction.missed_in_trial} in the trial; {expected}, {interval}"
    if most_at_once > overrun_ticks:
        advice = f"{most_at_once} at once stop the motors, timing.overrun_ticks bridges {overrun_ticks}: {mend}"
        yield Finding("bad", "missed ticks", found, advice)
    elif prediction.missed_in_trial or prediction.expected_missed >= 1.0:
        yield Finding("look", "missed ticks", found, f"{mend}; a longer trial (--seconds) narrows the interval")
    else:
        yield Finding("ok", "missed ticks", found)


def _parts(timing: LoopTiming) -> Finding:
    """Say where a tick's time goes; writing is that of its row and its commands."""
    parts = {"frames": timing.answer_time_s, "computing": timing.compute_time_s, "writing": timing.write_time_s}
    times = {"wake-up": _percentiles_us(timing.lateness_s)} | {name: _percentiles_us(values) for name, values in parts.items()}
    each = [f"{name} " + ", ".join(f"{share} {value:.0f}" for share, value in found.items()) for name, found in times.items()]
    return Finding("ok", "parts of a tick", f"{'; '.join(each)} us")


def _settings(machine: Machine, real_bus: bool, folder: Path, root: Path, idle: bool) -> Iterator[Finding]:
    """Check the computer's settings and software, and its disk where nothing else runs."""
    with real_time() as granted:
        pass
    yield software.python()
    yield software.libraries()
    yield computer.kernel(root)
    yield computer.scheduler(root, granted, real_bus)
    yield computer.locked_memory(root, granted)
    yield computer.processors(root)
    yield computer.governor(root)
    yield computer.clock_source(root)
    yield computer.timer_slack(root)
    yield computer.load(root)
    yield computer.swap(root, granted)
    if sys.platform == "linux":
        yield computer.shared_memory(root / "dev/shm", storage.free_bytes)
    else:
        yield unknown("shared memory", "this system keeps it in no folder")
    if not idle:
        yield unknown("disk", "not tried beside a bench that records")
        return
    needed = row_layout(machine).width * np.dtype(float).itemsize * machine.sample_rate_Hz
    try:
        speed: float | None = storage.written_bytes_s(folder)
    except OSError:
        speed = None
    yield storage.disk(folder, needed, speed, storage.free_bytes(folder))


def _wires(machine: Machine, bus: BusUrl, details: dict[str, Any] | None, root: Path) -> Iterator[Finding]:
    """Check what leads to the machine."""
    settings = machine.bus
    assert settings is not None
    if bus.interface == "udp_multicast":
        yield wire.loopback(root)
        return
    if bus.interface == "socketcan":
        yield from wire.can_interface(root, str(bus.channel), settings, details)
    elif bus.interface == "slcan":
        yield from wire.serial_line(root, str(bus.channel))
    else:
        yield unknown(f"CAN {bus.url}", "only its driver could say, and to open it would put a node on the bus")
    devices = [settings.imu.device] if settings.imu is not None else []
    if settings.io is not None and settings.io.url.startswith("rtu:"):
        parse_io_url(settings.io.url)
        devices.append(settings.io.url.removeprefix("rtu:").partition("@")[0])
    for device in devices:
        if device and not device.startswith("tcp:"):
            yield from wire.serial_line(root, device)


def _busy(bus: BusUrl, root: Path) -> str:
    """Return what runs on the bus or on this computer, or ''."""
    if running := wire.benches(root):
        return f"{running} bench{'es run' if running > 1 else ' runs'} on this computer"
    if bus.interface != "socketcan":
        return ""
    before = wire.frames_counted(root, str(bus.channel))
    if before is None:
        return ""
    time.sleep(LISTENED_S)
    frames = (wire.frames_counted(root, str(bus.channel)) or before) - before
    return f"{frames / LISTENED_S:.0f} frames/s on {bus.channel}" if frames else ""


def _answers(answer_s: float, machine: Machine) -> Finding:
    """Say how long the answers to a SYNC take on a CAN bus."""
    assert machine.bus is not None
    allowed_s = machine.bus.answer_timeout_s
    found = f"{MICROSECONDS * answer_s:.0f} us from SYNC to the last TPDO at {machine.bus.bitrate_bit_s} bit/s, and the nodes' own time"
    if answer_s > allowed_s:
        return Finding("bad", "answers", found, f"the loop waits {MICROSECONDS * allowed_s:.0f} us: fewer PDOs, or a higher bit rate")
    return Finding("ok", "answers", found)


def _wake_up_finding(late: np.ndarray, period_s: float) -> Finding:
    """Say how late a loop without a bus wakes up."""
    us = _percentiles_us(late)
    found = "p50 {:.0f}, p99 {:.0f}, p99.9 {:.0f}, max {:.0f} us late, without a bus".format(*us.values())
    worst = us["p99.9"] / MICROSECONDS / period_s
    if worst > GOOD_WAKE_UP_SHARE:
        advice = f"p99.9 of at most {GOOD_WAKE_UP_SHARE * period_s * MICROSECONDS:.0f} us: scheduler, kernel, load, stolen time"
        return Finding("bad" if worst > 1.0 else "look", "wake-up", found, advice)
    return Finding("ok", "wake-up", found)


def _count(value: float) -> str:
    """Write an expected number of ticks."""
    return f"{value:.1g}" if 0.0 < value < 1.0 else f"{value:.0f}"


def _percentiles_us(seconds: np.ndarray) -> dict[str, float]:
    values = [*np.percentile(seconds, [50.0, 99.0, 99.9]), seconds.max()]
    return {name: float(value) * MICROSECONDS for name, value in zip(("p50", "p99", "p99.9", "max"), values, strict=True)}

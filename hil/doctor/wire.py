"""Checks of what leads to a machine: CAN interface, serial adapters, loopback. They read what the kernel says and open no bus."""

from __future__ import annotations

import json
import os
import re
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from drivers.bus_url import ARPHRD_CAN, IFF_UP
from drivers.settings import BusSettings
from hil.doctor.finding import Finding, number_of, text_of, unknown
from hil.machine.bus_load import frames_sent

IP_S = 5.0
TICKS_QUEUED = 2
"""Ticks of frames that the interface's queue must take: a bus that is briefly occupied must not refuse a command."""
LONGEST_LATENCY_ms = 1
DROPS = ("rx_dropped", "tx_dropped", "rx_over_errors", "rx_fifo_errors", "rx_errors", "tx_errors")
BENCH = re.compile(r"isocenter-[^/\s]+/stop-[0-9a-f]{16}\.socket$", re.MULTILINE)
"""The socket at which a running bench takes requests to stop (`hil.bench.asking.stop_socket`)."""


def benches(root: Path) -> int | None:
    """Return how many benches run on this computer, of any user; None where the system does not say."""
    sockets = text_of(root / "proc/net/unix")
    return None if sockets is None else len(set(BENCH.findall(sockets)))


def frames_counted(root: Path, interface: str) -> int | None:
    """Return how many frames an interface has received and sent since it is there."""
    folder = root / "sys/class/net" / interface / "statistics"
    received, sent = number_of(folder / "rx_packets"), number_of(folder / "tx_packets")
    return None if received is None or sent is None else received + sent


def link_details(interface: str) -> dict[str, Any] | None:
    """Ask `ip` for the details of an interface; None where it cannot say."""
    try:
        done = subprocess.run(
            ["ip", "-details", "-json", "link", "show", "dev", interface], capture_output=True, text=True, timeout=IP_S, check=True
        )
        (found,) = json.loads(done.stdout)
    except (OSError, subprocess.SubprocessError, ValueError):
        return None
    return found if isinstance(found, dict) else None


def is_virtual(details: dict[str, Any] | None) -> bool:
    """Return whether these are the details of a virtual CAN interface, which has no bit rate."""
    return details is not None and details.get("linkinfo", {}).get("info_kind") == "vcan"


def can_interface(root: Path, interface: str, bus: BusSettings, details: dict[str, Any] | None) -> Iterator[Finding]:
    """Check a SocketCAN interface against the machine file's bus.

    Parameters
    ----------
    root : Path
    interface : str
    bus : BusSettings
    details : dict, optional
        See `link_details`.
    """
    check, entry = f"CAN {interface}", root / "sys/class/net" / interface
    bring_up = f"`ip link set {interface} up type can bitrate {bus.bitrate_bit_s}`"
    if not (root / "sys/class/net").is_dir():
        yield unknown(check, "this system has no /sys/class/net")
        return
    if not entry.is_dir():
        yield Finding("bad", check, "there is no such interface", "plug in the adapter and load its driver; `ip link` lists what is there")
        return
    if number_of(entry / "type") != ARPHRD_CAN:
        yield Finding("bad", check, "is no CAN interface", "`ip -details link` lists those that are")
        return
    flags = text_of(entry / "flags")
    if flags is not None and not int(flags, 16) & IFF_UP:
        yield Finding("bad", check, "the interface is down", bring_up)
    else:
        yield Finding("ok", check, "the interface is up")
    yield from _controller(check, interface, bus, details)
    queue, frames = number_of(entry / "tx_queue_len"), TICKS_QUEUED * frames_sent(bus)
    if queue is None:
        yield unknown(f"{check} queue", "the kernel does not say")
    elif queue < frames:
        advice = f"`ip link set {interface} txqueuelen {max(100, frames)}`"
        yield Finding("look", f"{check} queue", f"txqueuelen {queue}, {TICKS_QUEUED} ticks send {frames} frames", advice)
    else:
        yield Finding("ok", f"{check} queue", f"txqueuelen {queue}, {TICKS_QUEUED} ticks send {frames} frames")
    drops = {name: count for name in DROPS if (count := number_of(entry / "statistics" / name))}
    if drops:
        said = ", ".join(f"{name} {count}" for name, count in drops.items())
        yield Finding("look", f"{check} losses", said, "since the interface is there; look again after a run, they should not grow")
    elif (entry / "statistics").is_dir():
        yield Finding("ok", f"{check} losses", "no frame was dropped")


def _controller(check: str, interface: str, bus: BusSettings, details: dict[str, Any] | None) -> Iterator[Finding]:
    """Check what only netlink knows: bit rate, state, error counters, restart."""
    link = (details or {}).get("linkinfo", {})
    if is_virtual(details):
        yield Finding("ok", f"{check} bit rate", "virtual: has neither bit rate nor errors")
        return
    data = link.get("info_data")
    if not data:
        yield unknown(f"{check} bit rate", "`ip -details -json link` (iproute2) does not say; neither bit rate nor state were checked")
        return
    bitrate = data.get("bittiming", {}).get("bitrate")
    if bitrate is None:
        yield unknown(f"{check} bit rate", "the driver does not say")
    elif bitrate != bus.bitrate_bit_s:
        advice = f"the machine file says {bus.bitrate_bit_s}: `ip link set {interface} down`, then `ip link set {interface} up type can"
        yield Finding("bad", f"{check} bit rate", f"{bitrate} bit/s", f"{advice} bitrate {bus.bitrate_bit_s}`")
    else:
        yield Finding("ok", f"{check} bit rate", f"{bitrate} bit/s, as the machine file says")
    state, errors = data.get("state", "not told"), data.get("berr_counter", {})
    counted = f", errors sent {errors.get('tx', 0)}, received {errors.get('rx', 0)}" if errors else ""
    past = link.get("info_xstats", {})
    happened = "".join(f", {past[name]} times {words}" for name, words in _PAST.items() if past.get(name))
    wiring = "look at termination (60 ohm between the lines), bit rate of every node, cable and shield"
    if state in ("ERROR-PASSIVE", "BUS-OFF"):
        yield Finding("bad", f"{check} state", f"{state}{counted}{happened}", wiring)
    elif state != "ERROR-ACTIVE" or any(errors.values()) or happened:
        yield Finding("look", f"{check} state", f"{state}{counted}{happened}", wiring)
    else:
        yield Finding("ok", f"{check} state", f"{state}{counted}")
    restart = data.get("restart_ms")
    if restart:
        advice = f"a bus that fails must not mend itself unseen: `ip link set {interface} type can restart-ms 0`"
        yield Finding("look", f"{check} restart", f"{restart} ms after bus-off", advice)
    elif restart == 0:
        yield Finding("ok", f"{check} restart", "none after bus-off")


_PAST = {"error_warning": "at the warning limit", "error_passive": "error passive", "bus_off": "bus off"}


def may_open(path: Path) -> bool:
    """Return whether this user may read and write a device, without opening it."""
    return os.access(path, os.R_OK | os.W_OK)


def serial_line(root: Path, device: str, allowed: Callable[[Path], bool] = may_open) -> Iterator[Finding]:
    """Check a serial adapter: that it is there, may be used, and does not hold its bytes back.

    Parameters
    ----------
    root : Path
    device : str
        Such as /dev/ttyUSB0.
    allowed : callable
        See `may_open`.
    """
    check = f"serial {device}"
    if not device.startswith("/dev/"):
        yield unknown(check, "no device file; nothing was opened")
        return
    path = root / device.lstrip("/")
    if not path.exists():
        yield Finding("bad", check, "there is no such device", "plug it in, or name another; /dev/serial/by-id keeps its name")
        return
    if allowed(path):
        yield Finding("ok", check, "may be read and written")
    else:
        yield Finding("bad", check, "may not be read and written", "add the user to the group that owns it (dialout), and log in again")
    latency = number_of(root / "sys/class/tty" / path.resolve().name / "device/latency_timer")
    if latency is None:
        yield unknown(f"{check} latency", "no latency_timer, which FTDI's adapters have")
    elif latency > LONGEST_LATENCY_ms:
        advice = f"echo {LONGEST_LATENCY_ms} > /sys/class/tty/{path.resolve().name}/device/latency_timer, in a udev rule"
        yield Finding("look", f"{check} latency", f"the adapter holds bytes for {latency} ms", advice)
    else:
        yield Finding("ok", f"{check} latency", f"{latency} ms")


def loopback(root: Path) -> Finding:
    """Check the interface of udp: buses."""
    flags = text_of(root / "sys/class/net/lo/flags")
    if flags is None:
        return unknown("loopback", "this system has no /sys/class/net/lo")
    if not int(flags, 16) & IFF_UP:
        return Finding("bad", "loopback", "the interface lo is down", "`ip link set lo up`")
    return Finding("ok", "loopback", "up")

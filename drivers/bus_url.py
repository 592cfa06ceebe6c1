"""Bus URLs, which name the CAN interface that the bench opens.

virtual:NAME                    in this process (python-can's virtual bus)
socketcan:vcan0                 Linux SocketCAN
udp:GROUP[@PORT]                between processes of this host, over UDP multicast on the loopback interface
slcan:/dev/ttyACM0@1000000      serial adapter; after @ the serial line's baud rate (the CAN bit rate comes from the machine file)
INTERFACE:CHANNEL               any other back end of python-can
lockstep:                       in process, virtual time; not a bus of python-can, the bench builds it
"""

from __future__ import annotations

import contextlib
import difflib
import errno
import importlib.util
import ipaddress
import re
import socket
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.errors import BusUnavailableError

if TYPE_CHECKING:
    import can

DEFAULT_VIRTUAL_CHANNEL = "isocenter"
DEFAULT_UDP_GROUP = "239.74.163.2"  # python-can's administratively scoped IPv4 group: not routed beyond the site
ARPHRD_CAN = 280  # /sys/class/net/*/type of a CAN interface (linux/if_arp.h)
IFF_UP = 0x1
SLCAN_BIT_RATES = (10_000, 20_000, 50_000, 83_300, 100_000, 125_000, 250_000, 500_000, 750_000, 1_000_000)
EXAMPLES = "lockstep:, virtual:NAME, socketcan:vcan0, udp:GROUP, slcan:/dev/ttyACM0@1000000"


@dataclass(frozen=True)
class BusUrl:
    """The parts of a bus URL: python-can's interface, channel and further arguments."""

    url: str
    interface: str  # python-can's name, or "lockstep"
    channel: str | int
    options: dict[str, Any] = field(default_factory=dict)


def parse_bus_url(url: str) -> BusUrl:
    """Split a bus URL into its parts without opening anything.

    Raises
    ------
    BusUnavailableError
        The colon is missing, the interface is unknown, or the channel is invalid.

    Examples
    --------
    >>> from drivers.bus_url import parse_bus_url
    >>> parsed = parse_bus_url("virtual:bench")
    >>> parsed.interface, parsed.channel
    ('virtual', 'bench')
    """
    parsed = split_bus_url(url)
    if parsed.interface != "lockstep":
        _check_interface(url, parsed.interface)
    return parsed


def split_bus_url(url: str) -> BusUrl:
    """Split a bus URL into its parts, whether python-can knows its interface or not: importing that takes half a second.

    Raises
    ------
    BusUnavailableError
        The colon is missing, or the channel is invalid.
    """
    scheme, colon, rest = url.strip().partition(":")
    scheme = scheme.lower()
    if not colon or not scheme:
        raise BusUnavailableError(f"bus URL {url!r} has no interface and colon; write INTERFACE:CHANNEL, for example {EXAMPLES}")
    if scheme == "lockstep":
        if rest:
            raise BusUnavailableError(f"{url}: lockstep takes no channel; write lockstep:")
        return BusUrl(url, "lockstep", "")
    if scheme == "virtual":
        return BusUrl(url, "virtual", rest or DEFAULT_VIRTUAL_CHANNEL)
    if scheme in ("udp", "udp_multicast"):
        return _udp(url, rest)
    if not rest:
        _check_interface(url, scheme)
        raise BusUnavailableError(f"{url}: the channel is missing after the colon; for example {_example(scheme)}")
    if scheme == "slcan":
        return _slcan(url, rest)
    return BusUrl(url, scheme, int(rest) if re.fullmatch(r"[0-9]{1,9}", rest) else rest)


def open_bus(url: str, bitrate: int, *, stamped: bool = False) -> can.BusABC:
    """Open the bus a URL names.

    Parameters
    ----------
    url : str
        See the head of this module; `lockstep:` is refused, the bench builds that one itself.
    bitrate : int
        Bits per second. SocketCAN's is set with `ip link`, virtual and UDP buses have none.
    stamped : bool
        Frames over SocketCAN have the kernel's time stamp, which costs time; otherwise that of reading.

    Raises
    ------
    BusUnavailableError
        The bus cannot be opened; one line says what is wrong, and what would be right.
    """
    parsed = parse_bus_url(url)
    if parsed.interface == "lockstep":
        raise BusUnavailableError("lockstep: is no bus that can be opened alone: the bench builds it together with its emulated machine")
    arguments: dict[str, Any] = dict(parsed.options)
    if parsed.interface == "socketcan":
        _check_socketcan(url, str(parsed.channel), bitrate)
    elif parsed.interface == "udp_multicast":
        if importlib.util.find_spec("msgpack") is None:
            raise BusUnavailableError(f"{url}: UDP buses need the package msgpack; pip install msgpack")
    elif parsed.interface != "virtual":
        arguments["bitrate"] = bitrate
    if parsed.interface == "slcan" and bitrate not in SLCAN_BIT_RATES:
        raise BusUnavailableError(f"{url}: slcan has no code for {bitrate} bit/s; it knows {', '.join(map(str, SLCAN_BIT_RATES))}")
    try:
        if parsed.interface == "udp_multicast":
            from drivers.udp_bus import UdpBus

            return UdpBus(str(parsed.channel), **arguments)
        if parsed.interface == "socketcan" and not stamped:
            from drivers.socketcan_bus import SocketcanBus

            return SocketcanBus(str(parsed.channel))
        import can

        return can.Bus(interface=parsed.interface, channel=parsed.channel, ignore_config=True, **arguments)
    except Exception as error:  # back ends raise whatever their vendor's library does, NameError of a missing library included
        reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise BusUnavailableError(f"{url}: {reason}; {_remedy(parsed.interface)}") from error


def _check_interface(url: str, scheme: str) -> None:
    from can.interfaces import BACKENDS

    if scheme not in BACKENDS:
        close = difflib.get_close_matches(scheme, [*BACKENDS, "udp", "lockstep"], n=3, cutoff=0.5)
        hint = f"did you mean {' or '.join(close)}?" if close else f"known: lockstep, udp, {', '.join(sorted(BACKENDS))}"
        raise BusUnavailableError(f"{url}: no CAN interface is called {scheme!r}; {hint}")


def _udp(url: str, rest: str) -> BusUrl:
    group, _, port = rest.partition("@")
    group = group or DEFAULT_UDP_GROUP
    try:
        multicast = ipaddress.ip_address(group).is_multicast
    except ValueError:
        multicast = False
    if not multicast:
        raise BusUnavailableError(
            f"{url}: {group!r} is no multicast address; use 224.0.0.0 to 239.255.255.255, for example udp:{DEFAULT_UDP_GROUP}"
        )
    options: dict[str, Any] = {}
    if "@" in rest:
        options["port"] = _number(url, port, "UDP port", 1, 65535)
    return BusUrl(url, "udp_multicast", group, options)


def _slcan(url: str, rest: str) -> BusUrl:
    device, at, baud = rest.partition("@")
    if not device:
        raise BusUnavailableError(f"{url}: the serial device is missing; for example slcan:/dev/ttyACM0@1000000")
    return BusUrl(url, "slcan", device, {"tty_baudrate": _number(url, baud, "baud rate", 50, 100_000_000)} if at else {})


def _number(url: str, text: str, what: str, low: int, high: int) -> int:
    if not re.fullmatch(r"[0-9]{1,12}", text) or not low <= int(text) <= high:
        raise BusUnavailableError(f"{url}: {what} {text!r} must be a whole number from {low} to {high}")
    return int(text)


def _check_socketcan(url: str, name: str, bitrate: int) -> None:
    if not sys.platform.startswith("linux"):
        raise BusUnavailableError(f"{url}: SocketCAN exists on Linux only; use lockstep:, udp:, slcan:PORT or your adapter's own interface")
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError as error:
        if error.errno in (errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT):
            raise BusUnavailableError(
                f"{url}: this kernel has no CAN (AF_CAN); `modprobe -a can-raw vcan` as root, or use lockstep: or udp:"
            ) from error
        raise BusUnavailableError(f"{url}: no raw CAN socket may be opened: {error.strerror}") from error
    add = f"`ip link add dev {name} type vcan && ip link set up {name}`"
    bring_up = f"`ip link set {name} up type can bitrate {bitrate}`"
    try:
        socket.if_nametoindex(name)
    except (OSError, ValueError) as error:
        raise BusUnavailableError(f"{url}: no such interface; {add}, {_present_can_interfaces()}") from error
    entry = Path("/sys/class/net") / name
    with contextlib.suppress(OSError, ValueError):  # a container may hide sysfs: then binding tells
        if int((entry / "type").read_text()) != ARPHRD_CAN:
            raise BusUnavailableError(f"{url}: {name} is no CAN interface; {_present_can_interfaces()}")
        if not int((entry / "flags").read_text(), 16) & IFF_UP:
            raise BusUnavailableError(f"{url}: the interface is down; {f'`ip link set up {name}`' if name.startswith('v') else bring_up}")


def _present_can_interfaces() -> str:
    present = []
    for _, name in socket.if_nameindex():
        with contextlib.suppress(OSError, ValueError):
            if int((Path("/sys/class/net") / name / "type").read_text()) == ARPHRD_CAN:
                present.append(name)
    return f"or use one that is there: {', '.join(present)}" if present else "or use lockstep: or udp:, no CAN interface is there"


def _example(scheme: str) -> str:
    return {
        "socketcan": "socketcan:vcan0",
        "slcan": "slcan:/dev/ttyACM0@1000000",
        "pcan": "pcan:PCAN_USBBUS1",
        "kvaser": "kvaser:0",
        "ixxat": "ixxat:0",
        "vector": "vector:0",
    }.get(scheme, f"{scheme}:0")


def _remedy(interface: str) -> str:
    if interface == "slcan":
        return "name a serial port that exists and that nobody else uses"
    if interface == "udp_multicast":
        return f"use a group this host can join, for example udp:{DEFAULT_UDP_GROUP}"
    return "check the adapter, its driver and the channel's name"

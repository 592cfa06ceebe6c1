"""A CAN bus between the processes of one host: python-can's UDP multicast datagrams on the loopback interface, one system call per frame.

python-can sends through the socket it listens on, so every frame returns to its sender, unlike on a CAN controller; each echo wakes the
process and is decoded. Here frames leave through a separate socket, by whose address they are recognised, and on Linux the kernel drops
the echoes. Datagrams have no sender's proof: whoever reaches the port could move the machine. So nothing is sent to or taken from any
network interface but loopback, and what is no CAN frame is counted and dropped.
"""

from __future__ import annotations

import contextlib
import ctypes
import select
import socket
import struct
import sys
import time
from collections.abc import Callable
from operator import itemgetter

import can
import msgpack
from can.interfaces.udp_multicast.utils import pack_message

from drivers.data_frame import DataFrame

RECEIVE_BYTES = 4096
PYTHON_CAN_PORT = 43113
LOOPBACK_V4 = "127.0.0.1"
LOOPBACK_PREFIX_V4 = "127."  # RFC 1122, 3.2.1.3 (g): the whole block is this host's
LOOPBACK_V6 = "::1"
HOPS = 0  # a second lock: not even a router that listens on loopback passes a frame on
IP_MULTICAST_ALL, IPV6_MULTICAST_ALL = 49, 29  # linux/in.h, linux/in6.h; Python's socket module does not name them
SO_ATTACH_FILTER = 26  # asm-generic/socket.h
LOAD_WORD, LOAD_HALF, JUMP_EQUAL, RETURN = 0x20, 0x28, 0x15, 0x06  # classic BPF, linux/bpf_common.h
NETWORK_HEADER = -0x100000  # SKF_NET_OFF: offsets count from the IP header; plain ones from the UDP header
SOURCE_ADDRESS, SOURCE_PORT = 12, 0  # of the IPv4 header, of the UDP header
WHOLE, NOTHING = 0xFFFFFFFF, 0
DROPPED_AT_ONCE = 64
"""Most datagrams dropped in one look at the line: whoever floods it with garbage must not keep a loop from its tick."""

_flags_of = itemgetter("is_extended_id", "is_remote_frame", "is_error_frame", "is_fd", "bitrate_switch", "error_state_indicator")
_BOOL = {bool}
_STANDARD_IDS, _EXTENDED_IDS, _MOST_DATA = 1 << 11, 1 << 29, 8


class UdpBus(can.BusABC):
    """CAN 2.0 frames as datagrams to a multicast group on the loopback interface.

    Parameters
    ----------
    channel : str
        Multicast group, IPv4 or IPv6.
    port : int

    Attributes
    ----------
    malformed : int
        Datagrams dropped because they are no CAN 2.0 frame.
    strangers : int
        Datagrams dropped because they come from another interface than loopback.
    """

    def __init__(self, channel: str, port: int = PYTHON_CAN_PORT) -> None:
        super().__init__(channel=channel)
        self.channel_info = f"udp:{channel}" + ("" if port == PYTHON_CAN_PORT else f"@{port}")
        self.malformed = self.strangers = 0
        self._fields = msgpack.unpackb(pack_message(can.Message(is_extended_id=False)))  # of a data frame, as python-can names them
        self._packed: Callable[[object], bytes] = msgpack.Packer().pack
        self._sockets: list[socket.socket] = []
        self._mirror: tuple[socket.socket, socket.socket] | None = None
        try:
            self._listener = self._opened(_listening, channel, port)
            self._sender = self._opened(_sending, channel, port)
            self._own = self._sender.getsockname()[:2]
            if self._listener.family == socket.AF_INET:
                with contextlib.suppress(OSError):  # the bus works without rehearsals
                    listener = self._opened(_listening, channel, 0)
                    self._mirror = self._opened(_sending, channel, listener.getsockname()[1]), listener
                if sys.platform.startswith("linux"):
                    with contextlib.suppress(OSError):  # a sandbox's kernel may refuse filters; echoes are then dropped here
                        _drop_datagrams_from(self._listener, *self._own)
        except BaseException:
            self.shutdown()
            raise

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send as `can.BusABC` does; never waits."""
        self._send(pack_message(msg))

    def send_frame(self, can_id: int, data: bytes) -> None:
        """Send a data frame with an 11-bit identifier, without a message object around it."""
        fields = self._fields
        fields["arbitration_id"], fields["dlc"], fields["data"] = can_id, len(data), data
        self._send(self._packed(fields))

    def rehearse(self) -> None:
        """Send a frame and read it, between two sockets that nobody else listens on.

        Code that has not run for milliseconds runs slowly, because other processes have used the processor's caches: the first frame takes
        several times as long as the second. Call this shortly before a frame that matters.
        """
        if self._mirror is not None:
            sender, listener = self._mirror
            with contextlib.suppress(OSError):
                sender.send(self._packed(self._fields))
                frame_of(listener.recvfrom(RECEIVE_BYTES)[0])

    def fileno(self) -> int:
        """Return the descriptor of the socket that receives."""
        return self._listener.fileno()

    def _send(self, datagram: bytes) -> None:
        try:
            self._sender.send(datagram)
        except OSError as error:
            raise can.CanOperationError(f"failed to send: {error.strerror or error}", error.errno) from error

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Receive as `can.BusABC` does, but without its look at the clock and the log for every frame.

        Datagrams that are no CAN frame, or come from elsewhere, are dropped. After many of them without a frame in between, None is
        returned although more may lie in the queue.
        """
        give_up_s = None if timeout is None or timeout <= 0.0 else time.perf_counter() + timeout
        dropped = 0
        while dropped < DROPPED_AT_ONCE:
            try:
                data, sender = self._listener.recvfrom(RECEIVE_BYTES)
            except BlockingIOError:
                remaining = timeout if give_up_s is None else give_up_s - time.perf_counter()
                if (remaining is not None and remaining <= 0.0) or not select.select([self._listener], [], [], remaining)[0]:
                    return None
                continue
            except OSError as error:
                raise can.CanOperationError(f"failed to receive: {error.strerror or error}", error.errno) from error
            if sender[:2] == self._own:
                continue
            if not sender[0].startswith(LOOPBACK_PREFIX_V4) and sender[0] != LOOPBACK_V6:
                self.strangers += 1
            elif (message := frame_of(data)) is None:
                self.malformed += 1
            elif self._filters is None or self._matches_filters(message):
                return message
            else:
                continue
            dropped += 1
        return None

    def shutdown(self) -> None:
        """Close all sockets."""
        super().shutdown()
        for one in self._sockets:
            one.close()

    def _opened(self, configure: Callable[[socket.socket, str, int], None], channel: str, port: int) -> socket.socket:
        """Return a socket that is closed with the bus even where it cannot be configured."""
        family = socket.AF_INET6 if ":" in channel else socket.AF_INET
        one = socket.socket(family, socket.SOCK_DGRAM)
        self._sockets.append(one)
        configure(one, channel, port)
        return one


def frame_of(datagram: bytes) -> can.Message | None:
    """Return the CAN 2.0 frame in a datagram, stamped with the present time; None where there is none."""
    try:
        fields = msgpack.unpackb(datagram)
        identifier, data, dlc = fields["arbitration_id"], fields["data"], fields["dlc"]
        extended, remote, error, fd, switched, passive = flags = _flags_of(fields)
    except Exception:  # msgpack raises a dozen kinds, and what it unpacks may be anything
        return None
    if not (type(identifier) is type(dlc) is int and type(data) is bytes and set(map(type, flags)) == _BOOL):
        return None
    if fd or switched or passive or (remote and error) or not 0 <= dlc <= _MOST_DATA or len(data) != (0 if remote else dlc):
        return None
    if not 0 <= identifier < (_EXTENDED_IDS if extended else _STANDARD_IDS):
        return None
    if not (extended or remote or error):
        return DataFrame(identifier, data, time.time())
    return can.Message(time.time(), identifier, extended, remote, error, None, dlc, data)


def _listening(one: socket.socket, channel: str, port: int) -> None:
    """Have a socket receive what is sent to the group on the loopback interface."""
    v4 = one.family == socket.AF_INET
    one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # every process on the bus listens on this port
    if hasattr(socket, "SO_REUSEPORT"):
        one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
    # Windows binds to no group; there the source's address alone decides.
    one.bind(("" if sys.platform == "win32" else channel, port))
    group = socket.inet_pton(one.family, channel)
    if v4:
        one.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group + socket.inet_aton(LOOPBACK_V4))
    else:
        one.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_JOIN_GROUP, group + struct.pack("@I", _loopback_index()))
    if sys.platform.startswith("linux"):
        # Linux hands a port's datagrams of every group that anybody on the host has joined to every socket of that port, on any interface.
        one.setsockopt(*((socket.IPPROTO_IP, IP_MULTICAST_ALL) if v4 else (socket.IPPROTO_IPV6, IPV6_MULTICAST_ALL)), 0)
    one.setblocking(False)


def _sending(one: socket.socket, channel: str, port: int) -> None:
    """Have a socket send to the group on the loopback interface."""
    if one.family == socket.AF_INET:
        one.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(LOOPBACK_V4))
        one.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, HOPS)
    else:
        one.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_IF, _loopback_index())
        one.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_HOPS, HOPS)
    one.connect((channel, port))


def _loopback_index() -> int:
    """Return the number of the loopback interface: `lo`, `lo0` or `loopback_0`."""
    for index, name in socket.if_nameindex():
        if name.lower().startswith("lo"):
            return index
    raise OSError("this host has no loopback interface")


def _drop_datagrams_from(listener: socket.socket, address: str, port: int) -> None:
    """Have the kernel drop datagrams from this address (IPv4) before they wake a process."""
    instructions = (
        (LOAD_WORD, 0, 0, NETWORK_HEADER + SOURCE_ADDRESS & 0xFFFFFFFF),
        (JUMP_EQUAL, 0, 3, int.from_bytes(socket.inet_aton(address), "big")),
        (LOAD_HALF, 0, 0, SOURCE_PORT),
        (JUMP_EQUAL, 0, 1, port),
        (RETURN, 0, 0, NOTHING),
        (RETURN, 0, 0, WHOLE),
    )
    code = ctypes.create_string_buffer(b"".join(struct.pack("=HBBI", *instruction) for instruction in instructions))
    listener.setsockopt(socket.SOL_SOCKET, SO_ATTACH_FILTER, struct.pack("@HP", len(instructions), ctypes.addressof(code)))

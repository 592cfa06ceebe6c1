"""python-can's UDP multicast bus for a sample loop: the same datagrams, but no echo and one system call per frame.

python-can sends through the socket it listens on, so every frame returns to its sender, unlike on a CAN controller; each echo wakes the
process and is decoded. Here frames leave through a separate socket, by whose address they are recognised, and on Linux the kernel drops
the echoes.
"""

from __future__ import annotations

import contextlib
import ctypes
import select
import socket
import struct
import sys
import time

import can
import msgpack
from can.interfaces.udp_multicast import UdpMulticastBus
from can.interfaces.udp_multicast.utils import pack_message, unpack_message

RECEIVE_BYTES = 4096
PYTHON_CAN_PORT = 43113
IP_MULTICAST_ALL, IPV6_MULTICAST_ALL = 49, 29  # linux/in.h, linux/in6.h; Python's socket module does not name them
SO_ATTACH_FILTER = 26  # asm-generic/socket.h
LOAD_WORD, LOAD_HALF, JUMP_EQUAL, RETURN = 0x20, 0x28, 0x15, 0x06  # classic BPF, linux/bpf_common.h
NETWORK_HEADER = -0x100000  # SKF_NET_OFF: offsets count from the IP header; plain ones from the UDP header
SOURCE_ADDRESS, SOURCE_PORT = 12, 0  # of the IPv4 header, of the UDP header
WHOLE, NOTHING = 0xFFFFFFFF, 0


class UdpBus(UdpMulticastBus):
    """CAN frames as datagrams to a multicast group. Parameters are those of `UdpMulticastBus`.

    A hop limit of 0 keeps frames on this host, away from the network and other benches on it. With python-can's 1 they also leave through
    the host's network device, and sending one takes about twice the processor time (docs/explanation/timing.md).
    """

    def __init__(self, channel: str, port: int = PYTHON_CAN_PORT, hop_limit: int = 0, fd: bool = False) -> None:
        super().__init__(channel, port, hop_limit, fd=fd)
        self.channel_info = f"udp:{channel}" + ("" if port == PYTHON_CAN_PORT else f"@{port}")
        self._fields = msgpack.unpackb(pack_message(can.Message(is_extended_id=False)))  # of a data frame, as python-can names them
        multicast = self._multicast
        self._listener = listener = multicast._socket
        self._sender = sender = socket.socket(listener.family, socket.SOCK_DGRAM)
        self._mirror: tuple[socket.socket, socket.socket] | None = None
        v4 = listener.family == socket.AF_INET
        try:
            if v4:
                self._mirror = _mirror(channel)
            listener.setblocking(False)
            if v4:
                sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, hop_limit)
            else:
                sender.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_HOPS, hop_limit)
            sender.connect((channel, port))
            self._own = sender.getsockname()[:2]
            if sys.platform.startswith("linux"):
                # Linux hands a port's datagrams of every group that anybody on the host has joined to every socket of that port; python-can
                # leaves that on, and two benches on two groups would share one bus.
                listener.setsockopt(*((socket.IPPROTO_IP, IP_MULTICAST_ALL) if v4 else (socket.IPPROTO_IPV6, IPV6_MULTICAST_ALL)), 0)
                if v4:
                    with contextlib.suppress(OSError):  # a sandbox's kernel may refuse filters; echoes are then dropped here
                        _drop_datagrams_from(listener, *self._own)
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
        self._send(msgpack.packb(fields))

    def rehearse(self) -> None:
        """Send a frame and read it, between two sockets that nobody else listens on.

        Code that has not run for milliseconds runs slowly, because other processes have used the processor's caches: the first frame takes
        several times as long as the second. Call this shortly before a frame that matters.
        """
        if self._mirror is not None:
            sender, listener = self._mirror
            with contextlib.suppress(OSError, can.CanError):  # somebody else's datagram may have found the port
                sender.send(msgpack.packb(self._fields))
                _unpacked(*listener.recvfrom(RECEIVE_BYTES))

    def _send(self, datagram: bytes) -> None:
        try:
            self._sender.send(datagram)
        except OSError as error:
            raise can.CanOperationError(f"failed to send: {error.strerror or error}", error.errno) from error

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Receive as `can.BusABC` does, but without its look at the clock and the log for every frame."""
        give_up_s = None if timeout is None or timeout <= 0.0 else time.perf_counter() + timeout
        while True:
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
            message = _unpacked(data, sender)
            if self._filters is None or self._matches_filters(message):
                return message

    def shutdown(self) -> None:
        """Close all sockets."""
        super().shutdown()
        for one in (self._sender, *(self._mirror or ())):
            one.close()


def _unpacked(data: bytes, sender: tuple[str, int]) -> can.Message:
    try:
        return unpack_message(data, replace={"timestamp": time.time()}, check=True)
    except Exception as error:
        raise can.CanOperationError(f"a datagram of {len(data)} bytes from {sender[0]} is no CAN frame: {error}") from error


def _mirror(channel: str) -> tuple[socket.socket, socket.socket] | None:
    """Open two sockets on the group (IPv4), at a separate port and for this host only; the second receives what the first sends.

    Return None where the system refuses them.
    """
    sender, listener = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    try:
        listener.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(channel) + socket.inet_aton("0.0.0.0"))
        listener.bind(("", 0))
        listener.setblocking(False)
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
        sender.connect((channel, listener.getsockname()[1]))
    except OSError:
        sender.close()
        listener.close()
        return None
    return sender, listener


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

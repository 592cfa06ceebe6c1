"""Bus URLs: what opens, and what an unusable one is told."""

from __future__ import annotations

import socket
import sys
import uuid
from random import Random
from typing import Never

import can
import pytest
from can.interfaces.udp_multicast.utils import pack_message
from hypothesis import example, given
from hypothesis import strategies as st
from refusals import answer_or_refusal

from drivers.bus_url import open_bus, parse_bus_url
from drivers.errors import BusUnavailableError

IP_RECVTTL = 12  # linux/in.h; Python's socket module does not name it

SO_ATTACH_FILTER = 26  # asm-generic/socket.h
GROUP = "239.74.163.2"


def refusal(url: str, bitrate: int = 1_000_000) -> str:
    with pytest.raises(BusUnavailableError) as caught:
        open_bus(url, bitrate).shutdown()
    assert "\n" not in str(caught.value)
    assert caught.value.exit_status == 2
    return str(caught.value)


def test_virtual_buses_of_one_name_hear_each_other() -> None:
    name = uuid.uuid4().hex
    with open_bus(f"virtual:{name}", 1_000_000) as left, open_bus(f"virtual:{name}", 1_000_000) as right:
        left.send(can.Message(arbitration_id=0x181, is_extended_id=False, data=b"\x01\x02"))
        heard = right.recv(1.0)
    assert (heard.arbitration_id, bytes(heard.data)) == (0x181, b"\x01\x02")


def _udp_url() -> str:
    pytest.importorskip("msgpack")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    try:
        open_bus(f"udp:239.74.163.2@{port}", 1).shutdown()
    except BusUnavailableError as error:
        pytest.skip(f"this host joins no multicast group: {error}")
    return f"udp:239.74.163.2@{port}"


def _port(url: str) -> int:
    return int(url.rpartition("@")[2])


def _address_on_the_network() -> str:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # documentation's network: nothing is sent
        except OSError as error:
            pytest.skip(f"this host has no network: {error}")
        return str(probe.getsockname()[0])


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="filters are Linux's")
def test_a_kernel_that_refuses_socket_filters_has_a_udp_bus_all_the_same_and_no_echo(monkeypatch: pytest.MonkeyPatch) -> None:
    url, refused = _udp_url(), []

    class Sandboxed(socket.socket):
        def setsockopt(self, level: int, option: int, *value: object) -> None:
            if option == SO_ATTACH_FILTER:
                refused.append(option)
                raise PermissionError(1, "Operation not permitted")
            super().setsockopt(level, option, *value)

    monkeypatch.setattr(socket, "socket", Sandboxed)
    with open_bus(url, 1) as left, open_bus(url, 1) as right:
        left.send(can.Message(arbitration_id=0x181, is_extended_id=False, data=b"\x01"))
        assert right.recv(1.0).arbitration_id == 0x181
        assert left.recv(0.05) is None
    assert refused


def test_a_udp_bus_that_cannot_be_set_up_leaves_no_socket_open(monkeypatch: pytest.MonkeyPatch) -> None:
    url, opened = _udp_url(), []

    class Kept(socket.socket):
        def __init__(self, *arguments: int, **keywords: object) -> None:
            super().__init__(*arguments, **keywords)
            opened.append(self)

        def connect(self, address: object) -> Never:
            raise OSError(22, "Invalid argument")

    monkeypatch.setattr(socket, "socket", Kept)
    refusal(url)
    assert len(opened) >= 2
    assert all(one.fileno() == -1 for one in opened)


def test_udp_buses_of_one_group_hear_each_other() -> None:
    pytest.importorskip("msgpack")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    try:
        left, right = open_bus(f"udp:239.74.163.2@{port}", 1), open_bus(f"udp:@{port}", 1)
    except BusUnavailableError as error:
        pytest.skip(f"this host joins no multicast group: {error}")
    with left, right:
        try:
            left.send(can.Message(arbitration_id=0x80, is_extended_id=False))
        except can.CanError as error:
            pytest.skip(f"this host routes no multicast: {error}")
        heard = right.recv(2.0)
    assert heard is not None
    assert heard.arbitration_id == 0x80


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems keep groups apart by themselves")
def test_udp_buses_of_two_groups_do_not_hear_each_other() -> None:
    pytest.importorskip("msgpack")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    try:
        buses = [open_bus(f"udp:239.74.163.{k}@{port}", 1) for k in (21, 22, 22)]
    except BusUnavailableError as error:
        pytest.skip(f"this host joins no multicast group: {error}")
    other, sender, same = buses
    try:
        sender.send(can.Message(arbitration_id=0x80, is_extended_id=False))
        assert same.recv(2.0) is not None
        assert other.recv(0.0) is None
    except can.CanError as error:
        pytest.skip(f"this host routes no multicast: {error}")
    finally:
        for bus in buses:
            bus.shutdown()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="how a datagram's hop limit is asked for is Linux's")
def test_frames_of_a_udp_bus_do_not_leave_this_host() -> None:
    url = _udp_url()
    group, port = "239.74.163.2", int(url.rpartition("@")[2])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as witness, open_bus(url, 1) as bus:
        witness.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        witness.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(group) + socket.inet_aton("0.0.0.0"))
        witness.setsockopt(socket.IPPROTO_IP, IP_RECVTTL, 1)
        witness.bind((group, port))
        witness.settimeout(2.0)
        bus.send(can.Message(arbitration_id=0x80, is_extended_id=False))
        _, told, _, _ = witness.recvmsg(4096, socket.CMSG_SPACE(4))
    hops = [int.from_bytes(value, sys.byteorder) for level, kind, value in told if (level, kind) == (socket.IPPROTO_IP, socket.IP_TTL)]
    assert hops == [0]


def test_a_udp_bus_reads_python_cans_datagrams_and_does_not_hear_itself() -> None:
    url = _udp_url()
    with open_bus(url, 1) as ours, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as theirs:
        theirs.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        ours.send(can.Message(arbitration_id=0x181, is_extended_id=False, data=b"\x01\x02"))
        theirs.sendto(pack_message(can.Message(arbitration_id=0x201, is_extended_id=False, data=b"\x03")), (GROUP, _port(url)))
        heard = ours.recv(2.0)
        assert heard is not None
        assert (heard.arbitration_id, bytes(heard.data)) == (0x201, b"\x03")
        assert ours.recv(0.0) is None


def test_what_is_sent_on_a_network_interface_is_not_on_the_udp_bus() -> None:
    url = _udp_url()
    port = _port(url)
    own = _address_on_the_network()
    datagram = pack_message(can.Message(arbitration_id=0x201, is_extended_id=False, data=b"\x03"))
    with open_bus(url, 1) as bus, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        # somebody else on this host has joined the group there, so the datagrams do come this far
        with can.Bus(interface="udp_multicast", channel=GROUP, port=port, fd=False) as theirs:
            theirs.send(can.Message(arbitration_id=0x201, is_extended_id=False, data=b"\x03"))
        assert bus.recv(0.05) is None
        stranger.bind((own, 0))
        stranger.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        stranger.sendto(datagram, (GROUP, port))  # on the loopback interface, with another interface's address
        stranger.sendto(datagram, (own, port))  # to this port, not to the group
        assert bus.recv(0.05) is None
        assert bus.strangers == 1


@pytest.mark.slow
def test_a_udp_bus_that_is_fed_garbage_counts_it_and_hears_the_next_frame() -> None:
    url, random = _udp_url(), Random(1)
    good = pack_message(can.Message(arbitration_id=0x181, is_extended_id=False, data=b"\x07"))
    with open_bus(url, 1) as bus, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stray:
        stray.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        for number in range(1, 501):
            stray.sendto(random.randbytes(random.randrange(0, 200)), (GROUP, _port(url)))
            stray.sendto(good, (GROUP, _port(url)))
            assert bytes(bus.recv(2.0).data) == b"\x07"
            assert bus.malformed == number


def test_a_flood_of_garbage_does_not_hold_up_whoever_asks_for_a_frame_that_is_not_there() -> None:
    url = _udp_url()
    with open_bus(url, 1) as bus, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stray:
        stray.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        for _ in range(200):
            stray.sendto(b"?", (GROUP, _port(url)))
        assert bus.recv(0.0) is None
        assert 0 < bus.malformed < 100


@pytest.mark.parametrize(
    ("url", "interface", "channel", "options"),
    [
        ("lockstep:", "lockstep", "", {}),
        ("virtual:", "virtual", "isocenter", {}),
        ("SocketCAN:vcan0", "socketcan", "vcan0", {}),
        ("slcan:/dev/ttyACM0@1000000", "slcan", "/dev/ttyACM0", {"tty_baudrate": 1_000_000}),
        ("slcan:COM8", "slcan", "COM8", {}),
        ("udp:", "udp_multicast", "239.74.163.2", {}),
        ("udp:ff15::1@5000", "udp_multicast", "ff15::1", {"port": 5000}),
        ("pcan:PCAN_USBBUS1", "pcan", "PCAN_USBBUS1", {}),
        ("kvaser:0", "kvaser", 0, {}),
    ],
)
def test_urls_are_taken_apart_as_documented(url: str, interface: str, channel: int | str, options: dict[str, bool | int]) -> None:
    parsed = parse_bus_url(url)
    assert (parsed.interface, parsed.channel, parsed.options) == (interface, channel, options)


def test_lockstep_is_left_to_the_bench() -> None:
    assert "the bench builds it" in refusal("lockstep:")


def test_an_unknown_interface_names_the_closest_ones() -> None:
    assert "socketcan" in refusal("socketcam:vcan0")
    assert "kvaser" in refusal("kvasser:0")


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("vcan0", "INTERFACE:CHANNEL"),
        (":vcan0", "INTERFACE:CHANNEL"),
        ("socketcan:", "socketcan:vcan0"),
        ("lockstep:7", "no channel"),
        ("udp:10.0.0.1", "multicast"),
        ("udp:nonsense", "multicast"),
        ("udp:@99999", "65535"),
        ("slcan:@115200", "serial device"),
        ("slcan:/dev/ttyACM0@fast", "whole number"),
    ],
)
def test_a_malformed_url_is_told_what_would_be_right(url: str, words: str) -> None:
    assert words in refusal(url)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="SocketCAN is Linux")
def test_a_missing_can_interface_is_told_how_to_make_one() -> None:
    message = refusal("socketcan:vcan77")
    kernel_has_can = True
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError:
        kernel_has_can = False
    assert ("ip link add dev vcan77 type vcan" if kernel_has_can else "this kernel has no CAN") in message


@pytest.mark.parametrize("platform", ["win32", "darwin"])
def test_other_systems_are_told_that_socketcan_is_linux(monkeypatch: pytest.MonkeyPatch, platform: str) -> None:
    monkeypatch.setattr(sys, "platform", platform)
    assert "Linux only" in refusal("socketcan:can0")


def test_a_missing_serial_adapter_and_a_rate_it_cannot_do_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("time.sleep", lambda _: None)
    assert "/dev/isocenter-no-such-port" in refusal("slcan:/dev/isocenter-no-such-port@115200")
    assert "slcan has no code for 123456" in refusal("slcan:/dev/ttyACM0", 123_456)


def test_a_back_end_without_its_vendor_library_is_one_line() -> None:
    assert refusal("nixnet:CAN1").startswith("nixnet:CAN1: ")


@pytest.mark.slow
@given(st.text(max_size=40))
@example("udp:224.0.0.1@")
@example("slcan:@")
@example("kvaser:99999999999999999999")
def test_any_text_is_a_bus_url_or_one_clear_error(text: str) -> None:
    parsed, refusal = answer_or_refusal(BusUnavailableError, parse_bus_url, text)
    if parsed is None:
        assert refusal
    else:
        assert parsed.interface == "lockstep" or parsed.interface in can.interfaces.VALID_INTERFACES


def test_nobody_hears_a_udp_bus_rehearse() -> None:
    url = _udp_url()
    with open_bus(url, 1) as left, open_bus(url, 1) as right:
        left.rehearse()
        left.send(can.Message(arbitration_id=0x181, is_extended_id=False, data=b"\x01"))
        assert right.recv(2.0).arbitration_id == 0x181
        assert right.recv(0.0) is None
        assert left.recv(0.0) is None


def test_python_cans_own_bus_hears_every_frame_as_it_was_sent_and_no_rehearsal() -> None:
    url = _udp_url()
    port = int(url.partition("@")[2])
    sent, heard = [], []
    with open_bus(url, 1) as ours, can.Bus(interface="udp_multicast", channel="239.74.163.2", port=port, fd=False) as theirs:
        for number in range(300):
            can_id, data = number * 7 % 0x800, bytes(number % 256 for _ in range(number % 9))
            if number % 2:
                ours.send_frame(can_id, data)
            else:
                ours.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))
            ours.rehearse()
            sent.append((can_id, data, len(data)))
            message = theirs.recv(2.0)
            assert message is not None
            assert not (message.is_extended_id)
            assert not (message.is_remote_frame)
            assert not (message.is_error_frame)
            heard.append((message.arbitration_id, bytes(message.data), message.dlc))
        assert theirs.recv(0.0) is None
    assert heard == sent

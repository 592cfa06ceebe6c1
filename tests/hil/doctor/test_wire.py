"""What is said of CAN interfaces and serial adapters, from trees that are made up; no bus is opened."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import pytest

from hil.doctor import wire
from hil.doctor.finding import Finding
from hil.machine import load_machine
from hil.machine.bus_load import frame_bits, sync_answer_s

BUS = load_machine("carm").bus
assert BUS is not None
GOOD = {
    "linkinfo": {
        "info_kind": "can",
        "info_data": {"state": "ERROR-ACTIVE", "berr_counter": {"tx": 0, "rx": 0}, "restart_ms": 0, "bittiming": {"bitrate": 1_000_000}},
        "info_xstats": {"restarts": 0, "bus_error": 0, "error_warning": 0, "error_passive": 0, "bus_off": 0},
    }
}


def interface(root: Path, flags: str = "0x40041", kind: str = "280", queue: str = "100", **statistics: int) -> Path:
    """A CAN interface can0 as the kernel shows it."""
    folder = root / "sys/class/net/can0"
    (folder / "statistics").mkdir(parents=True)
    for name, text in {"flags": flags, "type": kind, "tx_queue_len": queue}.items():
        (folder / name).write_text(f"{text}\n")
    for name in (*wire.DROPS, "rx_packets", "tx_packets"):
        (folder / "statistics" / name).write_text(f"{statistics.get(name, 0)}\n")
    return root


def details(**changed: object) -> dict[str, Any]:
    """The answer of `ip` with some of its data changed."""
    return {"linkinfo": GOOD["linkinfo"] | {"info_data": GOOD["linkinfo"]["info_data"] | changed}}


def found_on(root: Path, said: dict[str, Any] | None = GOOD) -> dict[str, Finding]:
    assert BUS is not None
    return {finding.check.removeprefix("CAN can0").strip(): finding for finding in wire.can_interface(root, "can0", BUS, said)}


def test_a_good_interface_has_no_findings(tmp_path: Path) -> None:
    assert {finding.level for finding in found_on(interface(tmp_path)).values()} == {"ok"}


@pytest.mark.parametrize(
    ("changed", "check", "level", "word"),
    [
        ({"bittiming": {"bitrate": 500_000}}, "bit rate", "bad", "bitrate 1000000"),
        ({"state": "BUS-OFF"}, "state", "bad", "termination"),
        ({"state": "ERROR-PASSIVE"}, "state", "bad", "ERROR-PASSIVE"),
        ({"state": "ERROR-WARNING"}, "state", "look", "termination"),
        ({"berr_counter": {"tx": 0, "rx": 17}}, "state", "look", "received 17"),
        ({"restart_ms": 100}, "restart", "look", "restart-ms 0"),
    ],
)
def test_what_is_wrong_with_a_controller_is_found(tmp_path: Path, changed: dict[str, Any], check: str, level: str, word: str) -> None:
    findings = found_on(interface(tmp_path), details(**changed))
    assert findings[check].level == level
    assert word in str(findings[check])
    assert [name for name, finding in findings.items() if finding.level != "ok"] == [check]


def test_a_virtual_interface_has_no_bit_rate(tmp_path: Path) -> None:
    said = {"linkinfo": {"info_kind": "vcan"}}
    assert wire.is_virtual(said)
    assert not wire.is_virtual(GOOD)
    assert not wire.is_virtual(None)
    assert found_on(interface(tmp_path), said)["bit rate"].level == "ok"


def test_a_bus_off_of_the_past_is_told(tmp_path: Path) -> None:
    said = {"linkinfo": GOOD["linkinfo"] | {"info_xstats": {"bus_off": 2}}}
    assert "2 times bus off" in found_on(interface(tmp_path), said)["state"].found


def test_an_interface_that_is_down_absent_or_none_of_can_is_bad(tmp_path: Path) -> None:
    assert "bitrate 1000000" in found_on(interface(tmp_path / "down", flags="0x40040"))[""].advice
    assert [finding.level for finding in found_on(interface(tmp_path / "ether", kind="1")).values()] == ["bad"]
    (tmp_path / "empty/sys/class/net").mkdir(parents=True)
    assert [finding.level for finding in found_on(tmp_path / "empty").values()] == ["bad"]


def test_a_short_queue_and_lost_frames_are_told(tmp_path: Path) -> None:
    findings = found_on(interface(tmp_path, queue="3", tx_dropped=9))
    assert findings["queue"].level == "look"
    assert findings["losses"].level == "look"
    assert findings["losses"].found == "tx_dropped 9"


def test_without_netlink_or_sys_nothing_is_claimed(tmp_path: Path) -> None:
    assert found_on(interface(tmp_path / "a"), None)["bit rate"].level == "not known"
    assert [finding.level for finding in found_on(tmp_path / "b").values()] == ["not known"]
    assert wire.loopback(tmp_path).level == "not known"
    assert wire.benches(tmp_path) is None


def test_traffic_and_running_benches_are_seen_without_opening_anything(tmp_path: Path) -> None:
    assert wire.frames_counted(interface(tmp_path, rx_packets=40, tx_packets=2), "can0") == 42
    (tmp_path / "proc/net").mkdir(parents=True)
    line = "0000: 00000002 00000000 00000000 0002 01 4711 "
    paths = ["/run/user/1000/isocenter-1000/stop-0123456789abcdef.socket", "/run/dbus", "/tmp/isocenter-0/stop-fedcba9876543210.socket"]
    (tmp_path / "proc/net/unix").write_text("".join(f"{line}{path}\n" for path in paths))
    assert wire.benches(tmp_path) == 2


def test_an_adapter_that_holds_its_bytes_back_is_found(tmp_path: Path) -> None:
    device, latency = tmp_path / "dev/ttyUSB0", tmp_path / "sys/class/tty/ttyUSB0/device/latency_timer"
    for path in (device, latency):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("16\n")
    by_id = tmp_path / "dev/serial/by-id/usb-FTDI"
    by_id.parent.mkdir(parents=True)
    by_id.symlink_to(device)
    for name in ("/dev/ttyUSB0", "/dev/serial/by-id/usb-FTDI"):
        permission, held = wire.serial_line(tmp_path, name, lambda path: True)
        assert permission.level == "ok"
        assert held.level == "look"
        assert "16 ms" in held.found
    latency.write_text("1\n")
    assert [one.level for one in wire.serial_line(tmp_path, "/dev/ttyUSB0", lambda path: False)] == ["bad", "ok"]
    assert [one.level for one in wire.serial_line(tmp_path, "/dev/ttyUSB1")] == ["bad"]


def test_the_answers_to_a_sync_take_their_frames_on_the_wire() -> None:
    """Worst stuffing: 55 bits of an empty frame, 135 of eight bytes (Davis et al. 2007, table 1)."""
    assert BUS is not None
    assert (frame_bits(0), frame_bits(8)) == (55, 135)
    sizes = [sum(bits for _, _, bits in pdo.entries) // 8 for node in BUS.nodes for pdo in node.tpdos if 1 <= pdo.transmission_type <= 240]
    assert len(sizes) >= 4
    bits = 55 + frame_bits(1) + sum(frame_bits(size) for size in sizes)
    assert sync_answer_s(BUS) == pytest.approx(bits / 1e6)
    slower = dataclasses.replace(BUS, bitrate_bit_s=250_000)
    assert sync_answer_s(slower) == pytest.approx(4.0 * sync_answer_s(BUS))

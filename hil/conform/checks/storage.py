"""Store and restore parameters: what is written into a node's memory, so only with --writes."""

from __future__ import annotations

from canopen.objectdictionary import datatypes

from drivers.canopen.network import HEARTBEAT, NMT_RESET_NODE
from hil.conform.aborts import DEVICE_STATE, LOCAL_CONTROL, NOT_STORED
from hil.conform.check import Checks
from hil.conform.device import Device
from hil.conform.put_back import Values, put_back, values_of
from hil.conform.transfers import download

CHECKS = Checks("store and restore")
check = CHECKS.check
_SAVE, _LOAD = b"save", b"load"
_REFUSED = (NOT_STORED, LOCAL_CONTROL, DEVICE_STATE)
_STORED_MS = 0x0155
_OBJECTS = {"1010h": (0x1010, _SAVE), "1011h": (0x1011, _LOAD)}


@check("{}:01 without its signature is refused", "7.5.2.13 and 7.5.2.14", of=lambda device: list(_OBJECTS), writes=True)
def signature(device: Device, which: str) -> None:
    """Write words that are not the signature."""
    index, right = _OBJECTS[which]
    device.need(index, 1)
    for wrong in (right[::-1], bytes(4), right.upper()):
        device.expect_code(device.try_write(index, 1, wrong), _REFUSED, f"{wrong!r} is refused")


@check("{}:01 tells what the device can do", "7.5.2.13 and 7.5.2.14", of=lambda device: list(_OBJECTS))
def capability(device: Device, which: str) -> None:
    """Read the capability."""
    index, _ = _OBJECTS[which]
    device.need(index, 1, writable=False)
    value = device.number(index, 1)
    device.expect(value & ~3 == 0, "bits 0 and 1 only")


def _command(device: Device, index: int, signature_: bytes) -> None:
    code = download(device.wire, index, 1, signature_)
    device.expect(code == 0, f"{index:04X}h:01 takes {signature_!r}")


def _defaults(device: Device, key: tuple[int, int]) -> list[bytes]:
    """Return the default, and the value of a DCF; nothing where the data sheet gives none."""
    entry = device.entry(*key)
    if entry is None or entry.data_type not in datatypes.INTEGER_TYPES:
        return []
    given = [value for value in (entry.default, getattr(entry, "value", None)) if isinstance(value, int)]
    return [(value & ((1 << len(entry)) - 1)).to_bytes(len(entry) // 8, "little") for value in given]


@check("what is stored outlives a reset, and restoring gives every parameter the data sheet's default", "7.5.2.14", writes=True)
def store_and_restore(device: Device) -> None:
    """Store, reset, restore, reset; then write and store what was there before."""
    device.need(0x1010, 1)
    device.need(0x1011, 1)
    device.need(0x1017)
    device.reset(NMT_RESET_NODE)
    before = values_of(device, device.parameters())
    try:
        _run(device)
    finally:
        _put_back(device, before)


def _run(device: Device) -> None:
    device.write(0x1017, 0, _STORED_MS)
    _command(device, 0x1010, _SAVE)
    device.expect(device.reset(NMT_RESET_NODE) is not None, "a boot-up message")
    device.expect(device.number(0x1017) == _STORED_MS, f"1017h holds {_STORED_MS:04X}h after the reset")
    beat = device.wire.wait(HEARTBEAT + device.node_id, 2e-3 * _STORED_MS)
    device.expect(beat is not None, f"and a heartbeat comes within {2 * _STORED_MS} ms")
    _command(device, 0x1011, _LOAD)
    device.expect(device.number(0x1017) == _STORED_MS, "1017h holds it until the next reset")
    device.expect(device.reset(NMT_RESET_NODE) is not None, "a boot-up message")
    for key in values_of(device, device.parameters()):
        if defaults := _defaults(device, key):
            words = " or ".join(default.hex(" ").upper() for default in defaults)
            device.expect(device.read(*key) in defaults, f"{key[0]:04X}h:{key[1]:02X} holds its default {words}")


@check("1010h:02 stores the communication's parameters and no others", "7.5.2.13", writes=True)
def store_communication(device: Device) -> None:
    """Write one parameter of each kind, store the communication's, and reset."""
    device.need(0x1010, 2)
    device.need(0x1011, 1)
    device.need(0x1017)
    entry = device.spare_object()
    device.reset(NMT_RESET_NODE)
    before = values_of(device, device.parameters())
    own = before[entry.index, entry.subindex]
    try:
        device.write(0x1017, 0, _STORED_MS)
        device.expect(
            device.try_write(entry.index, entry.subindex, bytes((own[0] ^ 1,)) + own[1:]) == 0, f"{entry.index:04X}h takes a value"
        )
        device.expect(download(device.wire, 0x1010, 2, _SAVE) == 0, f"1010h:02 takes {_SAVE!r}")
        device.reset(NMT_RESET_NODE)
        device.expect(device.number(0x1017) == _STORED_MS, f"1017h holds {_STORED_MS:04X}h after the reset")
        device.expect(device.read(entry.index, entry.subindex) == own, f"{entry.index:04X}h holds {own.hex(' ').upper()} as before")
    finally:
        download(device.wire, 0x1011, 1, _LOAD)
        _put_back(device, before)


def _put_back(device: Device, before: Values) -> None:
    """Write what was there before, and store it where it is not the default."""
    device.reset(NMT_RESET_NODE)
    if any(device.try_read(*key) != value for key, value in before.items()):
        device.not_restored += put_back(device, before)
        download(device.wire, 0x1010, 1, _SAVE)
        device.reset(NMT_RESET_NODE)

"""Layer setting services, the slave's side (CiA 305): node id and bit timing over the bus, where the data sheet says LSS_Supported.

A virtual bus has no bit rate: a bit timing is taken and stored, and changes nothing.
"""

from __future__ import annotations

import struct
from typing import Protocol

import canopen

from virtual_bus.canopen.abort import SdoAbortError
from virtual_bus.canopen.objects import Objects
from virtual_bus.canopen.storage import LayerSettings, Storage

REQUEST, ANSWER = 0x7E5, 0x7E4
FRAME_BYTES = 8
UNCONFIGURED = 255  # a node id that stands for none
_SWITCH_GLOBAL, _SELECTED, _NODE_ID, _BIT_TIMING, _STORE = 0x04, 0x44, 0x11, 0x13, 0x17
_SELECT_FIRST, _SELECT_LAST = 0x40, 0x43
_IDENTIFY = {0x46: (0, "same"), 0x47: (1, "same"), 0x48: (2, "low"), 0x49: (2, "high"), 0x4A: (3, "low"), 0x4B: (3, "high")}
_IDENTIFY_UNCONFIGURED, _IDENTIFIED, _UNCONFIGURED_IDENTIFIED, _FASTSCAN = 0x4C, 0x4F, 0x50, 0x51
_INQUIRE_FIRST, _INQUIRE_LAST, _INQUIRE_NODE_ID = 0x5A, 0x5D, 0x5E
_DONE, _OUT_OF_RANGE, _STORE_FAILED = 0, 1, 2
_SCAN_ALL = 0x80  # fastscan's first question, to every device without a node id
_BIT_RATES = (1_000_000, 800_000, 500_000, 250_000, 125_000, None, 50_000, 20_000, 10_000)  # by index of CiA 305's table 0


class LssDevice(Protocol):
    """A node as its layer setting services see it."""

    node_id: int

    @property
    def objects(self) -> Objects:
        """The node's object dictionary."""

    def emit(self, can_id: int, data: bytes, /) -> None:
        """Send a frame."""

    def leave_unconfigured(self) -> None:
        """Boot with the node id that has been given."""


class LssSlave:
    """The layer setting services of one device.

    Parameters
    ----------
    device : LssDevice
    memory : Storage
        Keeps what `store configuration` asks for.
    information : canopen.objectdictionary.DeviceInformation
        Of the data sheet: whether there are such services, and which bit rates.
    """

    def __init__(self, device: LssDevice, memory: Storage, information: canopen.objectdictionary.DeviceInformation) -> None:
        self._device, self._memory = device, memory
        self.supported = bool(information.LSS_supported)
        self._bit_rates = information.allowed_baudrates
        kept = memory.layer_settings
        self.node_id = kept.node_id if kept is not None and self.supported else device.node_id  # from the next communication reset on
        self._bit_timing = kept.bit_timing if kept is not None else 0
        self._configuring = False
        self._matched = 0  # of vendor, product, revision and serial number: so many in a row
        self._identified = 0
        self._scanned = 0  # which of the four fastscan is at

    def receive(self, data: bytes) -> None:
        """Take a request of the master."""
        if len(data) != FRAME_BYTES:
            return
        command, number = data[0], int.from_bytes(data[1:5], "little")
        if command == _SWITCH_GLOBAL:
            self._switch(configuring=data[1] == 1)
        elif _SELECT_FIRST <= command <= _SELECT_LAST:
            self._select(command - _SELECT_FIRST, number)
        elif command in _IDENTIFY:
            self._identify(command, number)
        elif command == _IDENTIFY_UNCONFIGURED and self._device.node_id == UNCONFIGURED:
            self._answer(_UNCONFIGURED_IDENTIFIED)
        elif command == _FASTSCAN and not self._configuring and self._device.node_id == UNCONFIGURED:
            self._scan(number, *data[5:8])
        elif self._configuring:
            self._configure(command, data)

    def _identity(self, place: int) -> int:
        return self._device.objects.number(0x1018, place + 1)

    def _answer(self, command: int, rest: bytes = b"") -> None:
        self._device.emit(ANSWER, (bytes((command,)) + rest).ljust(FRAME_BYTES, b"\0"))

    def _switch(self, *, configuring: bool) -> None:
        self._configuring = configuring
        self._matched = 0
        if not configuring and self._device.node_id == UNCONFIGURED != self.node_id:
            self._device.leave_unconfigured()

    def _select(self, place: int, number: int) -> None:
        if self._configuring:
            return
        matches = self._identity(place) == number
        self._matched = place + 1 if matches and self._matched == place else int(matches and place == 0)
        if self._matched == _SELECT_LAST - _SELECT_FIRST + 1:
            self._switch(configuring=True)
            self._answer(_SELECTED)

    def _identify(self, command: int, number: int) -> None:
        place, bound = _IDENTIFY[command]
        own = self._identity(place)
        matches = own == number if bound == "same" else own >= number if bound == "low" else own <= number
        step = command - min(_IDENTIFY)
        self._identified = step + 1 if matches and self._identified == step else int(matches and step == 0)
        if self._identified == len(_IDENTIFY):
            self._identified = 0
            self._answer(_IDENTIFIED)

    def _scan(self, number: int, bit: int, place: int, following: int) -> None:
        """Answer when the bits of the identity down to `bit` are those of `number`."""
        if bit == _SCAN_ALL:
            self._scanned = 0
            self._answer(_IDENTIFIED)
        elif bit < 32 and place == self._scanned < 4 and following < 4 and not (self._identity(place) ^ number) >> bit:
            self._scanned = following
            self._answer(_IDENTIFIED)
            if bit == 0 and following < place:
                self._switch(configuring=True)

    def _configure(self, command: int, data: bytes) -> None:
        if command == _NODE_ID:
            valid = 1 <= data[1] <= 127 or data[1] == UNCONFIGURED
            if valid:
                self.node_id = data[1]
            self._answer(command, bytes((_DONE if valid else _OUT_OF_RANGE,)))
        elif command == _BIT_TIMING:
            valid = data[1] == 0 and data[2] < len(_BIT_RATES) and _BIT_RATES[data[2]] in self._bit_rates
            if valid:
                self._bit_timing = data[2]
            self._answer(command, bytes((_DONE if valid else _OUT_OF_RANGE,)))
        elif command == _STORE:
            self._store()
        elif _INQUIRE_FIRST <= command <= _INQUIRE_LAST:
            self._answer(command, struct.pack("<I", self._identity(command - _INQUIRE_FIRST)))
        elif command == _INQUIRE_NODE_ID:
            self._answer(command, bytes((self._device.node_id,)))

    def _store(self) -> None:
        try:
            self._memory.keep_layer_settings(LayerSettings(self.node_id, self._bit_timing))
        except SdoAbortError:
            self._answer(_STORE, bytes((_STORE_FAILED,)))
        else:
            self._answer(_STORE)

"""CiA 406 absolute rotary encoder: single turn, with direction, preset, and SYNC-driven or cyclic transmission."""

from __future__ import annotations

from pathlib import Path

from drivers.canopen.eds import load_object_dictionary
from virtual_bus.canopen import abort
from virtual_bus.canopen.abort import SdoAbortError
from virtual_bus.canopen.node import Emit, Node
from virtual_bus.canopen.objects import Value, key_of
from virtual_bus.settings import EmulatedEncoder

DESCENDING = 1 << 0  # 6000h: position falls when the shaft turns clockwise
SCALING = 1 << 2  # 6000h: 6001h and 6002h apply
_SUPPORTED_PARAMETERS = DESCENDING | SCALING


class Cia406Encoder(Node):
    """One link encoder. `settings.zero_counts` is its raw count at joint position zero, which depends on its mounting."""

    kept = frozenset({0x6509})  # the preset's offset

    def __init__(self, settings: EmulatedEncoder, emit: Emit, memory: Path | None = None) -> None:
        super().__init__(load_object_dictionary(settings.eds, settings.node_id), settings.node_id, emit, memory)
        self.settings = settings
        entry = self.objects.find
        self._position, self._offset = entry(0x6004), entry(0x6509)
        for index, value in ((0x6001, settings.counts_per_turn), (0x6002, settings.counts_per_turn), (0x6501, settings.counts_per_turn)):
            self.factory_setting(index, 0, value)
        self.objects.find(0x6002).high = settings.counts_per_turn
        self.factory_setting(0x650A, 3, settings.counts_per_turn - 1)
        self.objects.checks[key_of(0x6000)] = self._check_parameters
        self.objects.checks[key_of(0x6003)] = self._check_preset
        self.objects.effects[key_of(0x6000)] = lambda value: self._take_parameters()
        self.objects.effects[key_of(0x6002)] = lambda value: self._take_parameters()
        self.objects.effects[key_of(0x6509)] = lambda value: self._take_parameters()  # some data sheets let it be written
        self.objects.effects[key_of(0x6003)] = self._preset
        self.objects.effects[key_of(0x6200)] = self._set_cyclic_timer
        self._counts = 0  # from joint position zero
        self._range = settings.counts_per_turn
        self._direction, self._at_zero = settings.sign, settings.zero_counts  # of the position: per count, and at joint position zero

    def latch(self, counts: int) -> None:
        """Take the shaft's position at this sample, in counts from joint position zero."""
        self._counts = counts
        self._position.value = (self._direction * counts + self._at_zero) % self._range

    def application_reset(self) -> None:
        """Apply direction and preset as stored. An absolute encoder keeps its position."""
        self._take_parameters()

    @staticmethod
    def _check_parameters(value: Value) -> None:
        if int(value) & ~_SUPPORTED_PARAMETERS:
            raise SdoAbortError(abort.INVALID_VALUE)

    def _check_preset(self, value: Value) -> None:
        if int(value) >= self._range:
            raise SdoAbortError(abort.VALUE_TOO_HIGH)

    def _take_parameters(self) -> None:
        parameters = self.objects.number(0x6000)
        turn = -1 if parameters & DESCENDING else 1
        self._direction, self._at_zero = turn * self.settings.sign, turn * self.settings.zero_counts + self.objects.number(0x6509)
        self._range = self.objects.number(0x6002) if parameters & SCALING else self.settings.counts_per_turn
        self.objects.find(0x6500).value = parameters
        self.latch(self._counts)

    def _preset(self, value: Value) -> None:
        raw = self._direction * self._counts + self._at_zero - self.objects.number(0x6509)
        self._offset.value = int(value) - raw % self._range
        self._take_parameters()

    def _set_cyclic_timer(self, value: Value) -> None:
        """Set the event timer of the first TPDO, for which 6200h is an older name."""
        if entry := self.objects.get(0x1800, 5):
            entry.value = value
            self.objects.effects[entry.key](value)

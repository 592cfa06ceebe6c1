"""Store (1010h) and restore (1011h): the parameters a device keeps through a reset (CiA 301, 7.5.2.13 and 7.5.2.14)."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from virtual_bus.canopen import abort
from virtual_bus.canopen.abort import SdoAbortError
from virtual_bus.canopen.objects import Entry, Objects, Value, key_of
from virtual_bus.errors import EmulatorError

SAVE = int.from_bytes(b"save", "little")
LOAD = int.from_bytes(b"load", "little")
COMMUNICATION = range(0x1000, 0x2000)
_MANUFACTURER = range(0x2000, 0x6000)
_PROFILE = range(0x6000, 0xA000)
_ALL = range(0x1000, 0x10000)
_GROUPS = {1: _ALL, 2: COMMUNICATION, 3: _PROFILE, 4: _MANUFACTURER}
_NEVER_STORED = frozenset({0x1003, 0x1010, 0x1011})
VERIFY_CONFIGURATION = 0x1020  # date and time of a configuration, by which a manager knows it: no longer so once a parameter differs
_LAYER_SETTINGS = "LSS"  # their name in the file, where objects are INDEX:SUBINDEX
_STORES_ON_COMMAND = 1  # bit 0 of 1010h: saved on command only; of 1011h: can be restored


@dataclass(frozen=True)
class LayerSettings:
    """What CiA 305 lets a master store: the node id, 255 for none, and the index of the bit timing."""

    node_id: int
    bit_timing: int


class Storage:
    """Non-volatile memory of one device, in a file when one is given.

    Parameters
    ----------
    objects : Objects
    volatile : frozenset of int
        Indices whose values are process data and are never kept.
    kept : frozenset of int
        Indices that are kept though the bus cannot write them.
    path : Path, optional
        File of the memory; None keeps it as long as the device lives.

    Raises
    ------
    EmulatorError
        The file does not hold a device's stored parameters.
    """

    def __init__(self, objects: Objects, volatile: frozenset[int], kept: frozenset[int], path: Path | None) -> None:
        self._objects = objects
        self._volatile = volatile | _NEVER_STORED
        self._kept_read_only = kept
        self._path = path
        self._restore_requested: list[range] = []
        self.layer_settings: LayerSettings | None = None
        self._kept: dict[int, bytes] = self._read_file()
        objects.changed = self._changed
        for index, signature, action in ((0x1010, SAVE, self._save), (0x1011, LOAD, self._request_restore)):
            for entry in [entry for entry in objects if entry.index == index and entry.subindex]:
                self._install(entry, signature, action)

    def _install(self, entry: Entry, signature: int, action: Callable[[range], None]) -> None:
        group = _GROUPS.get(entry.subindex, range(0))

        def check(value: Value) -> None:
            if value != signature:
                raise SdoAbortError(abort.NOT_STORED)

        self._objects.checks[entry.key] = check
        self._objects.effects[entry.key] = lambda value: action(group)
        self._objects.readings[entry.key] = lambda: _STORES_ON_COMMAND

    def reset(self, indices: range) -> None:
        """Give every entry of `indices` its kept value, or its default where none is kept or a restore was requested."""
        for group in [group for group in self._restore_requested if group.start in indices or group == _ALL]:
            self._kept = {key: data for key, data in self._kept.items() if key >> 8 not in group}
            self._restore_requested.remove(group)
            self._write_file()
        for entry in self._objects:
            if entry.index in indices:
                kept = self._kept.get(entry.key)
                entry.value = entry.decode(kept) if kept is not None else entry.default

    def keep_layer_settings(self, settings: LayerSettings) -> None:
        """Keep what the layer setting services store.

        Raises
        ------
        SdoAbortError
            The file cannot be written.
        """
        self.layer_settings = settings
        self._write_file()

    def _is_parameter(self, entry: Entry) -> bool:
        return (entry.writable and entry.index not in self._volatile) or entry.index in self._kept_read_only

    def _changed(self, entry: Entry) -> None:
        """Forget by what a manager knows the configuration (CiA 301, 7.5.2.23)."""
        if entry.index != VERIFY_CONFIGURATION and self._is_parameter(entry):
            for subindex in (1, 2):
                if (told := self._objects.get(VERIFY_CONFIGURATION, subindex)) is not None:
                    told.value = 0

    def _save(self, group: range) -> None:
        for entry in self._objects:
            if self._is_parameter(entry) and entry.index in group:
                self._kept[entry.key] = entry.encode(entry.value)
        self._write_file()

    def _request_restore(self, group: range) -> None:
        self._restore_requested.append(group)

    def _read_file(self) -> dict[int, bytes]:
        if self._path is None or not self._path.exists():
            return {}
        try:
            text = json.loads(self._path.read_text(encoding="utf-8"))
            layer = bytes.fromhex(text.pop(_LAYER_SETTINGS, ""))
            self.layer_settings = LayerSettings(*layer) if layer else None
            kept = {key_of(int(name[:4], 16), int(name[5:], 16)): bytes.fromhex(data) for name, data in text.items()}
            for key, data in kept.items():
                if key in self._objects.entries:
                    self._objects.entries[key].decode(data)
        except (OSError, ValueError, TypeError, AttributeError, SdoAbortError) as error:
            advice = "delete it to start from the data sheet's defaults"
            raise EmulatorError(f"{self._path}: not a device's stored parameters ({error}); {advice}") from error
        return kept

    def _write_file(self) -> None:
        if self._path is None:
            return
        text = {f"{key >> 8:04X}:{key & 0xFF:02X}": data.hex() for key, data in sorted(self._kept.items())}
        if self.layer_settings is not None:
            text[_LAYER_SETTINGS] = bytes((self.layer_settings.node_id, self.layer_settings.bit_timing)).hex()
        part = self._path.with_suffix(self._path.suffix + ".part")
        try:
            part.write_text(json.dumps(text, indent=1), encoding="utf-8")
            os.replace(part, self._path)
        except OSError as error:
            raise SdoAbortError(abort.HARDWARE) from error

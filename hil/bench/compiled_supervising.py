"""The supervisor of lockstep: it notes frames as they come, and takes and judges all of them in one compiled call.

The laws are those of `drivers.supervisor.laws`, which the supervisor's own process runs as they stand: nothing is compiled there. Here a
call takes a tick's frames, where each by itself takes a call of many in Python.
"""

from __future__ import annotations

from struct import Struct
from types import FunctionType

import numpy as np
from numba import boolean, float64, int64, uint8
from numba.extending import register_jitable

from controllers.compiled import kept_on_disk
from drivers.supervisor import laws
from drivers.supervisor.laws import ASKS, Entry, judged, take_frame
from drivers.supervisor.memory import AXIS, FIELD, MACHINE, MOST_NOTED, NOTED_FORMAT
from drivers.supervisor.supervisor import Supervisor

for _law in vars(laws).values():
    if isinstance(_law, FunctionType) and _law.__module__ == laws.__name__:
        register_jitable(_law)

# One machine code for every machine, made when this is imported: a tick never waits for it. Entries go in as bytes: a call looks at the
# type of an array of entries for as long as the laws of a tick take.
_JUDGE = boolean(uint8[::1], uint8[::1], uint8[::1], int64, int64, float64)

_PACKS = [Struct("<" + number * NOTED_FORMAT).pack_into for number in range(MOST_NOTED + 1)]


@kept_on_disk(_JUDGE, fastmath=False, error_model="numpy")
def _judge(machine_bytes: np.ndarray, axes_bytes: np.ndarray, fields_bytes: np.ndarray, noted: int, question: int, time_s: float) -> bool:
    """Take the first so many frames that were noted, then answer the question; return whether motion is permitted."""
    machine, axes, fields = machine_bytes.view(MACHINE)[0], axes_bytes.view(AXIS), fields_bytes.view(FIELD)
    for k in range(noted):
        frame = machine.noted[k]
        for place in range(len(fields)):
            if fields[place].can_id == frame.can_id:
                take_frame(machine, axes, fields, place, frame.length, frame.word, frame.time_s)
                break
    return judged(machine, axes, question, time_s)


class CompiledSupervisor(Supervisor):
    """Judges as `Supervisor` does, to the bit; frames wait until somebody asks.

    Parameters
    ----------
    settings : BusSettings
    """

    def begin(self) -> None:
        """Begin a session: permit again, and forget what was seen."""
        super().begin()
        self._asking = {can_id for can_id, place in self._places.items() if self._fields[place].kind in ASKS}
        machines, axes = array_of(MACHINE, [self._machine]), array_of(AXIS, self._axes)
        self._bytes = machines.view(np.uint8), axes.view(np.uint8), array_of(FIELD, self._fields).view(np.uint8)
        self._machine, self._axes = machines.view(np.recarray)[0], list(axes.view(np.recarray))
        self._image = machines["noted"].view(np.uint8).reshape(-1).data
        self._is_permitted = True  # at the last judgement

    def frame(self, time_s: float, can_id: int, data: bytes) -> None:
        """Take note of a data frame with an 11-bit identifier, whoever sent it."""
        self.noted += can_id, bytes(data), time_s
        if len(self.noted) >= 3 * MOST_NOTED:
            self.take_noted()

    @property
    def reason(self) -> str:
        """What was wrong first, in words; '' where nothing was."""
        if not self._asking.isdisjoint(self.noted[::3]):  # no other ends the permission by itself
            self.take_noted()
        return self._words if self._words or self._is_permitted else super().reason

    def _judged(self, question: int, time_s: float) -> bool:
        """Judge all that was noted, answer the question, and return whether motion is permitted."""
        number = len(self.noted) // 3
        _PACKS[number](self._image, 0, *self.noted)
        self.noted.clear()
        self._is_permitted = _judge(*self._bytes, number, question, time_s)
        return self._is_permitted


def array_of(kind: np.dtype, entries: list[Entry]) -> np.ndarray:
    """Return entries that are objects as a structured array."""
    return np.array([_values(kind, entry) for entry in entries], kind)


def _values(kind: np.dtype, value: Entry) -> object:
    """Return an entry as NumPy takes it: fields in a tuple, and in it, of fields that are entries."""
    return value if kind.names is None else tuple(_values(kind[name], getattr(value, name)) for name in kind.names)

"""A bare device with filters on its wire, and settings that can be made to have no effect."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from virtual_bus.canopen.bare import BareMachine
from virtual_bus.canopen.node import Emit
from virtual_bus.canopen.objects import Value, key_of

Frame = tuple[int, bytes]
Filter = Callable[[int, bytes], list[Frame]]


class MutantMachine(BareMachine):
    """A bare device whose frames pass filters, in and out."""

    def __init__(self, eds: Path, node_id: int) -> None:
        super().__init__(eds, node_id)
        self.incoming: list[Filter] = []
        self.outgoing: list[Filter] = []
        self.guarded = False  # a remote frame is being answered
        self._sends: Emit = lambda can_id, data: None

    def connect(self, emit: Emit) -> None:
        """Set where frames go once the filters have seen them."""
        self._sends = emit

        def filtered(can_id: int, data: bytes) -> None:
            for sent in _through(self.outgoing, (can_id, data)):
                emit(*sent)

        super().connect(filtered)

    def say(self, can_id: int, data: bytes) -> None:
        """Send a frame past the filters."""
        self._sends(can_id, data)

    def receive(self, can_id: int, data: bytes) -> None:
        """Take a frame through the filters."""
        for taken in _through(self.incoming, (can_id, data)):
            super().receive(*taken)

    def receive_remote(self, can_id: int) -> None:
        """Take a remote frame."""
        self.guarded = True
        super().receive_remote(can_id)
        self.guarded = False

    def without_effect(self, index: int, subindex: int = 0, instead: int = 0) -> None:
        """Let an object be written and read back as ever, while the device goes on as if it held `instead`."""
        objects = self.node.objects
        entry = objects.find(index, subindex)
        key = key_of(index, subindex)
        shown: list[Value] = []
        after = objects.effects.get(key)

        def forget(value: Value) -> None:
            shown[:] = [value]
            entry.value = instead
            if after is not None:
                after(instead)

        reset = self.node._memory.reset

        def reset_and_show(indices: range) -> None:
            reset(indices)
            if index in indices:
                shown.clear()

        self.node._memory.reset = reset_and_show  # type: ignore[method-assign]
        objects.effects[key] = forget
        objects.readings[key] = lambda: shown[0] if shown else entry.value


def _through(filters: list[Filter], frame: Frame) -> list[Frame]:
    frames = [frame]
    for one in filters:
        frames = [passed for each in frames for passed in one(*each)]
    return frames

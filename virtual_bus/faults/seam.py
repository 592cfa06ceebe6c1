"""A place in the emulated machine at which something passes, and where faults may change it."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Change = TypeVar("Change")
Undo = Callable[[], None]
"""Takes a fault back."""


class Seam(Generic[Change]):
    """Changes by key (an axis, a node), in the order in which they came.

    Parameters
    ----------
    changed : callable, optional
        Called after a change has been added or removed.
    """

    def __init__(self, changed: Callable[[], None] = lambda: None) -> None:
        self._by_key: dict[Hashable, list[Change]] = {}
        self._changed = changed

    def add(self, key: Hashable, change: Change) -> Undo:
        """Add a change and return what removes it."""
        self._by_key.setdefault(key, []).append(change)
        self._changed()

        def undo() -> None:
            there = self._by_key.get(key, [])
            if change in there:
                there.remove(change)
            if not there:
                self._by_key.pop(key, None)
            self._changed()

        return undo

    def at(self, key: Hashable) -> tuple[Change, ...]:
        """Return the changes of a key."""
        return tuple(self._by_key.get(key, ()))

    def places(self) -> tuple[Hashable, ...]:
        """Return the keys that have a change."""
        return tuple(self._by_key)


def both(*undos: Undo) -> Undo:
    """Return what takes several changes back."""

    def undo() -> None:
        for one in undos:
            one()

    return undo

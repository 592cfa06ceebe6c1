"""Keys of caches for objects that have no hash, or a slow one."""

from __future__ import annotations

from typing import Generic, TypeVar

T = TypeVar("T")


class Same(Generic[T]):
    """A key that equals only a key of the very same object, which it keeps alive.

    An entry cached by it holds until the object changes.
    """

    def __init__(self, it: T) -> None:
        self.it = it

    def __hash__(self) -> int:
        """Return the identity of the object."""
        return id(self.it)

    def __eq__(self, other: object) -> bool:
        """Return whether the other key holds the same object."""
        return isinstance(other, Same) and other.it is self.it

"""The face that all modes of operation share. The drive asks the mode it displays once per sample while operation is enabled."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar

from virtual_bus.canopen.servo import Demand, Number, Servo

Read = Callable[[Number], int]
"""Returns what an object holds: now, or after the next SYNC."""

TARGET_REACHED, MODE_BIT_12, MODE_BIT_13 = 1 << 10, 1 << 12, 1 << 13  # of the statusword
FOLLOWS_COMMAND = MODE_BIT_12  # in the cyclic modes


class Mode:
    """No mode: no torque. The other modes fill in what differs.

    Attributes
    ----------
    number : int
        Value of 6060h and 6061h.
    supported_bit : int
        Bit of 6502h; -1 for none.
    needs : tuple of int
        Objects without which the device does not have the mode.
    observes : bool
        Whether the mode judges every sample by `observe`.
    steady : bool
        Whether its bits of the statusword change with nothing but being in charge; such a mode observes nothing.
    """

    number: ClassVar[int] = 0
    supported_bit: ClassVar[int] = -1
    needs: ClassVar[tuple[int, ...]] = ()
    observes: ClassVar[bool] = False
    steady: ClassVar[bool] = False

    def __init__(self, servo: Servo) -> None:
        self.servo = servo

    def start(self) -> None:
        """Take the motor over, at its present speed and torque: operation is enabled, a stop is over, or the mode has changed."""

    def torque(self) -> int:
        """Return the torque of this sample, per mille of rated."""
        return 0

    def foreseen(self, read: Read, *, takes_over: bool) -> int:
        """Return what `torque` will return next if the objects hold what `read` returns; nothing changes."""
        return self.servo.permille

    def observe(self, *, in_charge: bool) -> int:
        """Judge the sensors' newest values and return the code of a fault, 0 for none; a halt is in charge where the mode is not."""
        return 0

    def obey(self, word: int, previous: int, *, halted: bool) -> None:
        """Take the mode's own bits of a controlword."""

    def halt(self) -> None:
        """Make room for a halt."""

    def leave(self) -> None:
        """Give up what is under way: a stop, another mode or another state is in charge."""

    def status(self, *, in_charge: bool) -> int:
        """Return the mode's own bits of the statusword."""
        return 0


class Following(Mode, ABC):
    """A mode whose demand the servo follows by its own loops."""

    @abstractmethod
    def demand(self, read: Read) -> Demand:
        """Return what the servo is to follow in this sample; nothing changes."""

    def torque(self) -> int:
        """Return the torque that follows the demand."""
        return self.servo.follow(self.demand(present))

    def foreseen(self, read: Read, *, takes_over: bool) -> int:
        """Return the torque that will follow the demand."""
        return self.servo.foreseen(self.demand(read), takes_over=takes_over)


def present(entry: Number) -> int:
    """Return what an object holds now."""
    return entry.value

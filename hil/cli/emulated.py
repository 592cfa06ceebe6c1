"""What ran on the emulator is told so wherever its numbers are shown: nobody is to take them for a real machine's."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hil.recording import Recording
    from hil.terminal.output import Answer

EMULATED = "EMULATED: "
"""How a line about an emulated machine begins."""


def say_emulated(answer: Answer, recordings: Mapping[Path, Recording] | Mapping[str, Recording]) -> bool:
    """Say which recordings are of an emulated machine, and return whether any is."""
    found = [Path(name).name for name, recording in recordings.items() if recording.emulated]
    if not found:
        return False
    if len(found) == 1:
        which = f"{found[0]} was"
    elif len(found) == len(recordings):
        which = f"all {len(found)} recordings were"
    else:
        which = f"{', '.join(found)} were"
    answer.say(f"{EMULATED}{which} made on the emulator, not on a real machine")
    return True

"""What ran on the emulator is told so wherever its numbers are shown: nobody is to take them for a real machine's."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.verbs.verb import EMULATED as EMULATED

if TYPE_CHECKING:
    from hil.recording import Recording
    from hil.terminal.output import Answer


def say_emulated(answer: Answer, recordings: Mapping[Any, Recording]) -> None:
    """Say which recordings, by their files, are of an emulated machine."""
    found = [Path(name).name for name, recording in recordings.items() if recording.emulated]
    if not found:
        return
    if len(found) == 1:
        which = f"{found[0]} was"
    elif len(found) == len(recordings):
        which = f"all {len(found)} recordings were"
    else:
        which = f"{', '.join(found)} were"
    answer.say(f"{EMULATED}{which} made on the emulator, not on a real machine")

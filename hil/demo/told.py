"""What happened in a demo, for its page."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from hil.demo.hidden import Envelope
from hil.demo.judged import Judged
from hil.diagnosis.verdict.values import Outcome
from hil.machine import Machine
from hil.recording import Recording


@dataclass(frozen=True, eq=False)
class Story:
    """What happened.

    Attributes
    ----------
    machine : Machine
        As its file says.
    envelope : Envelope
    paths : tuple of Path
        Recordings, the held-out one last.
    held_out : Recording
    answered : Outcome
    judged : Judged
    recorded_s : float
        Of machine time.
    """

    machine: Machine
    envelope: Envelope
    paths: tuple[Path, ...]
    held_out: Recording
    answered: Outcome
    judged: Judged
    recorded_s: float

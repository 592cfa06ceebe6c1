"""A log of frames as a conversation, node by node: what was said in which order, whatever the values and for how many ticks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby

from hil.machine import Machine

Tick = tuple[str, ...]
"""What one node and the bench say to each other from a SYNC to the next."""

WORD = 4
"""Hexadecimal digits of the controlword or statusword that begins a drive's process data."""
COMMAND = 8
"""Hexadecimal digits of command, index and subindex of an SDO."""
UPLOAD = "4"
"""First digit of an SDO that reads an object, and of its answer."""
SPOILED = 2
"""Ticks that a late answer is missing from or stands in: its own, and the next."""


def since_the_bench_came(frames: list[str]) -> list[str]:
    """Without the boot-ups of a machine switched on before its bench connects: candump is there already, the lockstep log is not."""
    return frames[next(i for i, frame in enumerate(frames) if frame.startswith("000#")) :]


def conversations(frames: Sequence[str], machine: Machine) -> dict[str, list[Tick]]:
    """Every node's ticks, in order. Heartbeats, and settings that are read back while SYNCs run, hang on time alone and are left out."""
    assert machine.bus is not None
    found = {}
    for node in machine.bus.nodes:
        kinds = {f"{machine.bus.sync_cob_id:03X}": ("SYNC", 0)}
        kinds |= {f"{0x600 + node.node_id:03X}": ("SDO asked", COMMAND), f"{0x580 + node.node_id:03X}": ("SDO answered", COMMAND)}
        kinds |= {f"{0x080 + node.node_id:03X}": ("EMCY", WORD)}
        kept = WORD if node.role == "drive" else 0
        kinds |= {f"{pdo.cob_id:03X}": ("TPDO", kept) for pdo in node.tpdos} | {f"{pdo.cob_id:03X}": ("RPDO", kept) for pdo in node.rpdos}
        found[node.name] = list(_ticks(frames, kinds, f"{node.node_id:02X}"))
    return found


def _ticks(frames: Sequence[str], kinds: Mapping[str, tuple[str, int]], node: str) -> Iterator[Tick]:
    tick: list[str] = []
    for frame in frames:
        identifier, data = frame.split("#")
        if identifier == "000":
            if data[2:4] in (node, "00"):
                tick.append(f"NMT {data[:2]}")
        elif identifier in kinds:
            kind, kept = kinds[identifier]
            if kind == "SYNC":
                yield tuple(tick)
                tick = []
            elif kind.startswith("SDO") and data[:1] == UPLOAD and tick[:1] and tick[0].startswith("SYNC"):
                continue
            tick.append(f"{kind} {data[:kept]}")
    yield tuple(tick)


def differing(seen: Sequence[Tick], wanted: Sequence[Tick], late: int) -> str:
    """Where two conversations of a node differ, in words; '' where they do not.

    Ticks in a row that are alike count as one: another sample rate has more or fewer of them. A tick that is nowhere in `wanted` may be
    left out for each that a late answer has spoiled; `late` is how many the run has told of.
    """
    known = set(wanted)
    strange = sum(tick not in known for tick in seen)
    if strange > SPOILED * late:
        return f"{strange} ticks that are unknown, such as {next(tick for tick in seen if tick not in known)}; {late} answers were late"
    ours, theirs = ([tick for tick, _ in groupby(ticks)] for ticks in ([tick for tick in seen if tick in known], wanted))
    if ours == theirs:
        return ""
    first = next((i for i, (one, other) in enumerate(zip(ours, theirs, strict=False)) if one != other), min(len(ours), len(theirs)))
    return f"from step {first} on {ours[first : first + 2]}, in lockstep {theirs[first : first + 2]}"

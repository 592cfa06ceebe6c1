"""What the emulated devices answer in lockstep to the frames of another run."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from hil.emulated.machine import build_emulated
from hil.machine import Machine
from virtual_bus.emulator import LOOK_S


def of_the_bench(frame: str, machine: Machine) -> bool:
    """Whether the bench has sent this frame, and not a device."""
    assert machine.bus is not None
    identifier = frame.partition("#")[0]
    sent = {0x000, machine.bus.sync_cob_id, 0x700 + machine.bus.master_node_id}
    sent |= {0x600 + node.node_id for node in machine.bus.nodes} | {pdo.cob_id for node in machine.bus.nodes for pdo in node.rpdos}
    return int(identifier, 16) in sent


def answers(frames: Sequence[str], machine: Machine) -> dict[str, list[str]]:
    """What each device has sent, by identifier; without heartbeats, which hang on its clock alone."""
    found: dict[str, list[str]] = {}
    for frame in frames:
        if not of_the_bench(frame, machine) and not re.match(r"7..#(04|05|7F)", frame):
            found.setdefault(frame.partition("#")[0], []).append(frame)
    return found


def answered_in_lockstep(stamped: Sequence[tuple[float, str]], machine: Machine, seed: int) -> list[str]:
    """What the emulated devices send, from power-on, when they are given the frames of a bench in the same order, with the same pauses."""
    emulated, said = build_emulated(machine, np.zeros(len(machine.axes)), seed=seed), []
    emulated.connect(lambda can_id, data: said.append(f"{can_id:03X}#{data.hex().upper()}"))
    emulated.power_on()
    before_s = stamped[0][0]
    for time_s, frame in stamped:
        emulated.idle(min(time_s - before_s, LOOK_S))
        before_s = time_s
        if of_the_bench(frame, machine):
            identifier, data = frame.split("#")
            emulated.receive(int(identifier, 16), bytes.fromhex(data))
    return said

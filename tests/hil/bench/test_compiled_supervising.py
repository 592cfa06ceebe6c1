"""Compiled, the supervisor judges every frame as its laws do in Python, to the bit, however late it is asked."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import replace
from math import inf

import numpy as np
import pytest
from bench_machines import CARM, carm_text_in
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.settings import BusSettings
from drivers.supervisor.laws import TAKE
from drivers.supervisor.memory import AXIS, MACHINE, MOST_NOTED
from drivers.supervisor.supervisor import Supervisor
from hil.bench.compiled_supervising import CompiledSupervisor, array_of
from hil.machine import machine_from_text

assert CARM.bus is not None


def bus_of(mode: str) -> BusSettings:
    found = machine_from_text(carm_text_in(mode)).bus
    assert found is not None
    return found


MACHINES = (
    CARM.bus,
    bus_of("velocity"),
    bus_of("position"),
    bus_of("profile_position"),
    replace(CARM.bus, scalings=tuple(replace(scaling, link_resolution=0.0) for scaling in CARM.bus.scalings)),
    replace(CARM.bus, motions=tuple(replace(limits, acceleration=inf, holding_effort=1.0) for limits in CARM.bus.motions)),
)
STATES = (0x1637, 0x1637, 0x1633, 0x1617, 0x163F, 0x0650)
"""In operation enabled, switched on, in quick stop, in a fault reaction, switched off."""


def leaves(array: np.ndarray, other: np.ndarray) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Yield all numbers of two structured arrays but the frames that were noted, by name."""
    for name in set(array.dtype.names or ()) - {"noted"}:
        if array[name].dtype.names is None:
            yield name, array[name], other[name]
        else:
            yield from leaves(array[name], other[name])


class Both:
    """The same machine before two supervisors."""

    def __init__(self, bus: BusSettings) -> None:
        self.bus, self.time_s = bus, 1.0
        self.plain, self.compiled = Supervisor(bus), CompiledSupervisor(bus)
        self.position, self.link = [0.0] * len(bus.scalings), [0.0] * len(bus.scalings)  # rad

    def frame(self, can_id: int, data: bytes) -> None:
        self.plain.frame(self.time_s, can_id, data)
        self.compiled.frame(self.time_s, can_id, data)

    def same(self, ask: str, *arguments: object) -> None:
        """Ask both, and compare."""
        assert getattr(self.plain, ask)(*arguments) == getattr(self.compiled, ask)(*arguments), ask

    def compare(self) -> None:
        """Compare what they say, and all that they keep in mind."""
        assert self.plain.reason == self.compiled.reason
        assert self.plain.torque == self.compiled.torque
        self.compiled._judged(TAKE, 0.0)
        machines, axes = self.compiled._bytes[0].view(MACHINE), self.compiled._bytes[1].view(AXIS)
        for kind, entries, array in ((MACHINE, [self.plain._machine], machines), (AXIS, self.plain._axes, axes)):
            for name, kept, expected in leaves(array, array_of(kind, entries)):
                assert kept.tobytes() == expected.tobytes(), name

    def tick(self, status: int, speed: float, apart: float, asked: int, measured: int, lasts: float, lacks: int) -> None:
        """Let a tick pass as a machine makes it, whose last axis is as told; `lacks`: the frame that is missing."""
        self.time_s += lasts * self.bus.sync_period_s
        frames = []
        for node in self.bus.nodes:
            number = [scaling.axis for scaling in self.bus.scalings].index(node.axis)
            scaling, limits, is_last = self.bus.scalings[number], self.bus.motions[number], number == len(self.bus.scalings) - 1
            if node.role == "drive" and is_last:
                self.position[number] += speed * limits.speed * self.bus.sync_period_s
                self.link[number] += (speed + apart) * limits.speed * self.bus.sync_period_s
            counts = round(scaling.sign * self.position[number] / scaling.position_resolution)
            link = round(self.link[number] / scaling.link_resolution) + scaling.link_zero_counts if scaling.link_resolution else 0
            values = {0x6041: 0x1633, 0x6064: counts, 0x6004: link, 0x607A: counts + asked}
            if is_last:
                values |= dict.fromkeys((0x6071, 0x60B2, 0x60FF), asked) | dict.fromkeys((0x6077, 0x6078), measured) | {0x6041: status}
            for pdo in (*node.rpdos, *node.tpdos):
                word = shift = 0
                for index, _, bits in pdo.entries:
                    word |= (values.get(index, 0) & (1 << bits) - 1) << shift
                    shift += bits
                frames.append((pdo.cob_id, word.to_bytes(shift // 8, "little")))
        for k, frame in enumerate(frames):
            if k != lacks:
                self.frame(*frame)
            if k == len(self.bus.scalings):
                self.frame(self.bus.sync_cob_id, b"")


SPELLS = st.tuples(
    st.integers(1, 40),
    st.sampled_from(STATES),
    st.sampled_from((0.0, 0.0, 0.9, -0.9, 1.6, -1.6, 0.01, 40.0)),
    st.sampled_from((0.0, 0.0, 0.0, 0.3, -0.5, -2.0)),
    st.sampled_from((0, 0, 400, -900, 2000, 1_000_000)),
    st.sampled_from((0, 0, 250, -301, 1400, -1400)),
    st.sampled_from((1.0, 1.0, 1.0, 0.6, 0.0, -1.0, 30.0)),
    st.sampled_from((-1, -1, -1, 0, 2, 3)),
)
IDENTIFIERS = sorted({0x000, 0x700, 0x601, 0x602, *Supervisor(CARM.bus)._places, *Supervisor(MACHINES[3])._places})
WORDS = st.one_of(st.binary(max_size=10), st.integers(0, 255).map(lambda mode: struct.pack("<IBBBB", 0x60602F, mode, 0, 0, 0)))
FRAMES = st.lists(st.tuples(st.sampled_from(IDENTIFIERS), WORDS), min_size=1, max_size=2 * MOST_NOTED)
ASKS = st.sampled_from(("begin", "end", "held_up", "io", "release", "open", "ask_to_stop", "refuse", "answer", "nothing"))


@given(st.sampled_from(MACHINES), st.lists(st.tuples(SPELLS, ASKS, st.one_of(st.just([]), FRAMES)), min_size=1, max_size=12))
@settings(deadline=None, max_examples=120, derandomize=True)
def test_compiled_it_finds_what_its_laws_find_in_python(
    bus: BusSettings, story: list[tuple[tuple[int, int, float, float, int, int, float, int], str, list[tuple[int, bytes]]]]
) -> None:
    both = Both(bus)
    for (ticks, *how), ask, frames in story:
        for _ in range(ticks):
            both.tick(*how)
            both.same("check", both.time_s)
            both.same("commands", both.time_s)
        both.compare()
        for frame in frames:
            both.frame(*frame)
        if ask in ("io", "release", "open"):
            both.same("io", both.time_s, ask != "release", True, [ask == "open"] * len(bus.scalings))
        elif ask in ("ask_to_stop", "refuse"):
            both.same(ask, both.time_s, "somebody")
        elif ask == "answer":
            both.same(ask, both.time_s, 5)
        elif ask != "nothing":
            both.same(ask)
        both.compare()


@pytest.mark.parametrize("number", [0, 1, MOST_NOTED - 1, MOST_NOTED, MOST_NOTED + 1, 3 * MOST_NOTED])
def test_frames_that_wait_are_all_judged(number: int) -> None:
    both = Both(MACHINES[0])
    for k in range(number):
        both.time_s += both.bus.sync_period_s
        both.frame(both.bus.sync_cob_id, b"")
        both.frame(0x7FF, bytes([k % 256]))
    both.compare()
    both.frame(MACHINES[0].nodes[0].rpdos[0].cob_id, b"\x0f\0\xff\x7f")
    assert "was asked for" in both.compiled.reason, "at once"
    both.compare()

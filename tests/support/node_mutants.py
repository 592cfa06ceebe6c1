"""Defects that implementers of a CANopen node really make, put into an emulated bare device: operators, and a sample by a fixed seed.

Operators change what goes over the wire, or what the dictionary's settings do; they know nothing of how a node is judged.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import node_defects_objects as objects
import node_defects_wire as wire
from mutant_machine import MutantMachine

SEED = 20_250_301
DRAWN = 30


@dataclass(frozen=True)
class Mutant:
    """One defect: its kind, which of its variants, and what puts it into a device."""

    kind: str
    variant: str
    apply: Callable[[MutantMachine], None]

    def __str__(self) -> str:
        return f"{self.kind} [{self.variant}]"

    def machine(self, eds: Path, node_id: int) -> MutantMachine:
        """A bare device with this defect."""
        device = MutantMachine(eds, node_id)
        self.apply(device)
        return device


def all_mutants() -> list[Mutant]:
    """Every variant of every operator, in a fixed order."""
    return [Mutant(kind, variant, apply) for kind, variants in KINDS.items() for variant, apply in variants()]


def drawn_mutants(count: int = DRAWN, seed: int = SEED) -> list[Mutant]:
    """A sample without repetition: one variant each of kinds in a drawn order, then, once all kinds have had their turn, further ones."""
    draw = random.Random(seed)
    left = all_mutants()
    draw.shuffle(left)
    sample: list[Mutant] = []
    while left and len(sample) < count:
        turn = {mutant.kind: mutant for mutant in reversed(left)}  # the first of each kind, in the drawn order
        sample += [mutant for mutant in left if turn[mutant.kind] is mutant]
        left = [mutant for mutant in left if turn[mutant.kind] is not mutant]
    return sample[:count]


KINDS: dict[str, Callable[[], Iterator[tuple[str, Callable[[MutantMachine], None]]]]] = {
    "wrong abort code": wire.wrong_abort_code,
    "toggle bit not checked": wire.toggle_not_checked,
    "toggle bit of the answer stuck": wire.toggle_stuck,
    "COB-ID taken while valid": objects.cob_id_taken_while_valid,
    "restricted COB-ID taken": objects.restricted_cob_id_taken,
    "heartbeat time wrong by a factor": objects.heartbeat_factor,
    "boot-up missing": wire.boot_up_missing,
    "PDO in pre-operational": objects.pdo_in_pre_operational,
    "SDO answered in stopped": objects.sdo_in_stopped,
    "transmission type ignored": objects.transmission_type_ignored,
    "wrong mapping taken": objects.wrong_mapping_taken,
    "byte order reversed": wire.byte_order,
    "segmented size wrong": wire.segmented_size,
    "segmented data cut": wire.segmented_data_cut,
    "block checksum wrong": wire.block_checksum,
    "block sequence wrong": wire.block_sequence,
    "NMT broadcast ignored": wire.broadcast_ignored,
    "NMT command to another node obeyed": wire.foreign_nmt_obeyed,
    "NMT command without effect": wire.nmt_command_ignored,
    "read-only object written": objects.read_only_written,
    "value range not checked": objects.range_not_checked,
    "length not checked": wire.length_not_checked,
    "identity count wrong": objects.identity_count,
    "value differs from the data sheet": objects.value_differs,
    "absent object read as zero": wire.absent_read_as_zero,
    "answer to a client's abort": wire.abort_answered,
    "unknown command met with silence": wire.unknown_command_silent,
    "wrong multiplexer": wire.wrong_multiplexer,
    "NMT state told wrong": wire.state_told_wrong,
    "SYNC counter wrong": objects.sync_counter,
    "inhibit time ignored": objects.inhibit_time_ignored,
    "event time wrong": objects.event_time,
    "RPDO deadline ignored": objects.rpdo_deadline_ignored,
    "guarding toggle stuck": wire.guarding_toggle_stuck,
    "life guarding without effect": objects.life_guarding_ignored,
    "heartbeat consumer without effect": objects.heartbeat_consumer_ignored,
    "error behaviour ignored": objects.error_behaviour_ignored,
    "EMCY wrong": wire.emergency_wrong,
    "error history wrong": objects.error_history,
    "signature not asked for": objects.signature_not_checked,
    "communication reset keeps settings": objects.reset_keeps_settings,
    "LSS wrong": wire.lss_wrong,
    "RPDO of a wrong length taken": wire.short_rpdo_taken,
}

"""How full a machine's CAN bus is: the frames of one cycle in bits, worst stuffing."""

from __future__ import annotations

from drivers.settings import BusSettings, Pdo

OVERHEAD_BITS = 47  # standard frame: start, identifier, control, CRC, acknowledge, end and intermission
STUFFABLE_OVERHEAD_BITS = 34  # of these, the bits under bit stuffing
EVERY_SYNC = range(1, 241)  # transmission types of synchronous PDOs


def frame_bits(data_bytes: int) -> int:
    """Bits of a standard frame with the most stuff bits it can have (Davis, Burns, Bril, Lukkien 2007, eq. (1))."""
    return OVERHEAD_BITS + 8 * data_bytes + (STUFFABLE_OVERHEAD_BITS + 8 * data_bytes - 1) // 4


def sync_answer_s(bus: BusSettings) -> float:
    """Return the time [s] from the begin of a SYNC to the end of the last TPDO that answers it, on a tick in which all do.

    A frame that is already being sent when the SYNC is due, a heartbeat, is part of it; the time that nodes take to answer is not.
    """
    bits = frame_bits(1) + frame_bits(0)
    for node in bus.nodes:
        bits += sum(frame_bits(_bytes(pdo)) for pdo in node.tpdos if pdo.transmission_type in EVERY_SYNC)
    return bits / bus.bitrate_bit_s


def frames_sent(bus: BusSettings) -> int:
    """Return the most frames that the bench sends in a tick: commands, SYNC, heartbeat."""
    return sum(len(node.rpdos) for node in bus.nodes) + 2


def bus_load(bus: BusSettings) -> float:
    """Share of the bit rate that SYNC, PDOs and heartbeats take."""
    bits_s = frame_bits(0) / bus.sync_period_s
    for node in bus.nodes:
        for pdo in (*node.tpdos, *node.rpdos):
            every = pdo.transmission_type if pdo.transmission_type in EVERY_SYNC and pdo in node.tpdos else 1
            bits_s += frame_bits(_bytes(pdo)) / (bus.sync_period_s * every)
        bits_s += frame_bits(1) / node.heartbeat_period_s
    bits_s += frame_bits(1) / bus.master_heartbeat_period_s
    return bits_s / bus.bitrate_bit_s


def _bytes(pdo: Pdo) -> int:
    return sum(bits for _, _, bits in pdo.entries) // 8

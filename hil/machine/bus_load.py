"""How full a machine's CAN bus is: the frames of one cycle in bits, worst stuffing."""

from __future__ import annotations

from drivers.settings import BusSettings

OVERHEAD_BITS = 47  # standard frame: start, identifier, control, CRC, acknowledge, end and intermission
STUFFABLE_OVERHEAD_BITS = 34  # of these, the bits under bit stuffing
EVERY_SYNC = range(1, 241)  # transmission types of synchronous PDOs


def frame_bits(data_bytes: int) -> int:
    """Bits of a standard frame with the most stuff bits it can have (Davis, Burns, Bril, Lukkien 2007, eq. (1))."""
    return OVERHEAD_BITS + 8 * data_bytes + (STUFFABLE_OVERHEAD_BITS + 8 * data_bytes - 1) // 4


def bus_load(bus: BusSettings) -> float:
    """Share of the bit rate that SYNC, PDOs and heartbeats take."""
    bits_s = frame_bits(0) / bus.sync_period_s
    for node in bus.nodes:
        for pdo in (*node.tpdos, *node.rpdos):
            every = pdo.transmission_type if pdo.transmission_type in EVERY_SYNC and pdo in node.tpdos else 1
            bits_s += frame_bits(sum(bits for _, _, bits in pdo.entries) // 8) / (bus.sync_period_s * every)
        bits_s += frame_bits(1) / node.heartbeat_period_s
    bits_s += frame_bits(1) / bus.master_heartbeat_period_s
    return bits_s / bus.bitrate_bit_s

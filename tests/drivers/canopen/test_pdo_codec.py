"""PDO packing against the bit order of CiA 301, written out as strings of bits."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.canopen.pdo import PdoCodec
from drivers.errors import ProtocolError


def by_bit_string(values: tuple[int, ...], widths: tuple[int, ...]) -> bytes:
    """First object in the lowest bits, each least significant bit first: the string of bits is read backwards."""
    bits = "".join(format(value & (1 << width) - 1, f"0{width}b") for value, width in reversed(list(zip(values, widths, strict=True))))
    bits = bits.rjust(-(-len(bits) // 8) * 8, "0")
    return bytes(int(bits[i : i + 8], 2) for i in range(0, len(bits), 8))[::-1]


@st.composite
def mappings(draw: Callable[..., object]) -> tuple[tuple[int, ...], tuple[bool, ...], tuple[int, ...]]:
    widths, signed, values = [], [], []
    for _ in range(draw(st.integers(1, 8))):
        width = draw(st.sampled_from([1, 3, 8, 8, 16, 16, 24, 32, 32, 64]))
        if sum(widths) + width > 64:
            break
        sign = draw(st.booleans())
        low, high = (-(1 << width - 1), (1 << width - 1) - 1) if sign else (0, (1 << width) - 1)
        widths.append(width)
        signed.append(sign)
        values.append(draw(st.integers(low, high)))
    return (tuple(widths), tuple(signed), tuple(values)) if widths else ((8,), (False,), (0,))


@given(mappings())
def test_any_mapping_packs_as_the_standard_orders_bits_and_unpacks_again(
    mapping: tuple[tuple[int, ...], tuple[bool, ...], tuple[int, ...]],
) -> None:
    widths, signed, values = mapping
    codec = PdoCodec(widths, signed)
    assert codec.pack(*values) == by_bit_string(values, widths)
    assert codec.unpack(codec.pack(*values)) == values


def test_the_drives_tpdo_is_the_byte_table() -> None:
    codec = PdoCodec.of([(0x6041, 0, 16), (0x6064, 0, 32), (0x6078, 0, 16)])
    assert codec.unpack(bytes.fromhex("3712 feffffff 9cff")) == (0x1237, -2, -100)


@given(st.binary(max_size=7))
def test_a_frame_shorter_than_its_mapping_is_a_protocol_error(data: bytes) -> None:
    with pytest.raises(ProtocolError, match="8 are mapped"):
        PdoCodec.of([(0x6041, 0, 16), (0x6064, 0, 32), (0x6078, 0, 16)]).unpack(data)


def test_bytes_beyond_the_mapping_are_ignored() -> None:
    assert PdoCodec((16,), (False,)).unpack(b"\x01\x02\xff\xff") == (0x0201,)


@pytest.mark.parametrize(("widths", "value"), [((16,), 40000), ((16,), -40000), ((12,), 2048), ((12,), -2049)])
def test_a_value_that_does_not_fit_is_refused_not_cut(widths: tuple[int], value: int) -> None:
    with pytest.raises(ProtocolError, match="fit"):
        PdoCodec(widths, (True,)).pack(value)


@pytest.mark.parametrize("widths", [(), (64, 1), (0,), (8, 0)])
def test_a_mapping_that_is_none_is_refused(widths: tuple[int, ...]) -> None:
    with pytest.raises(ProtocolError, match="1 to 64"):
        PdoCodec(widths, (False,) * len(widths))

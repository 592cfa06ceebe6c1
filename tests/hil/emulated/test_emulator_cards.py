"""Cards of emulators on this host: anything that is not one is none, and never an error."""

from __future__ import annotations

import json
import os
from dataclasses import asdict

from hypothesis import example, given
from hypothesis import strategies as st

from hil.emulated.card import EmulatorCard, card_from_text

LARGEST_PID = 2**31 - 1  # pid_t has 32 bits and a sign
cards = st.builds(EmulatorCard, **{name: st.text() for name in EmulatorCard.__annotations__} | {"pid": st.integers(1, LARGEST_PID)})
WHOLE = asdict(EmulatorCard("b", os.getpid(), "", ""))
names = st.sampled_from(list(EmulatorCard.__annotations__))
documents = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text() | names, inner, max_size=5),
    max_leaves=12,
)


@given(cards)
def test_a_card_is_read_as_it_was_written(card: EmulatorCard) -> None:
    assert card_from_text(json.dumps(asdict(card))) == card


@given(st.text() | documents.map(json.dumps))
@example('{"bus": 1')
@example("[" * 100_000)
@example(json.dumps(WHOLE | {"pid": 0}))
@example(json.dumps(WHOLE | {"pid": True}))
@example(json.dumps(WHOLE | {"pid": LARGEST_PID + 1}))
@example(json.dumps(WHOLE | {"pid": 10**30}))
@example(json.dumps(WHOLE | {"imu_device": 5}))
def test_any_other_text_is_no_card_or_a_whole_one(text: str) -> None:
    card = card_from_text(text)
    if card is not None:
        assert asdict(card) == json.loads(text)
        assert 0 < card.pid <= LARGEST_PID


@given(cards, names, st.none() | st.floats() | st.lists(st.text(), max_size=1))
def test_a_card_with_one_entry_of_another_kind_is_none(card: EmulatorCard, name: str, value: object) -> None:
    assert card_from_text(json.dumps(asdict(card) | {name: value})) is None
    assert card_from_text(json.dumps({key: entry for key, entry in asdict(card).items() if key != name})) is None

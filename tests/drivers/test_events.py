"""The audit trail keeps its beginning and its end in bounded memory."""

from __future__ import annotations

from drivers.events import FIRST_KEPT, LAST_KEPT, Events


def test_events_carry_the_time_since_the_session_began() -> None:
    now = [5.0]
    events = Events(lambda: now[0])
    now[0] = 7.5
    events.add("operator", "stop asked", reason="SIGINT")
    (event,) = events.all()
    assert (event.time_s, event.who, event.what, event.details) == (2.5, "operator", "stop asked", {"reason": "SIGINT"})
    events.begin()
    assert events.time_s == 0.0
    assert not events.all()


def test_of_too_many_events_the_first_and_the_newest_are_kept_and_the_rest_counted() -> None:
    events = Events(lambda: 0.0)
    for number in range(10_000):
        events.append(float(number), "loop", "tick")
    times = [event.time_s for event in events.all()]
    assert times[:FIRST_KEPT] == list(range(FIRST_KEPT))
    assert times[FIRST_KEPT:] == list(range(10_000 - LAST_KEPT, 10_000))
    assert events.dropped == 10_000 - FIRST_KEPT - LAST_KEPT

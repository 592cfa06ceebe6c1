"""Shared memory between the loop and who looks at images: what is told and sent comes whole, and what is lost is counted."""

import multiprocessing

import numpy as np
import pytest

from hil.imaging.mailbox import LETTERS, LoopEnd, Mailbox, Sighting

CONTEXT, PERIOD = multiprocessing.get_context("spawn"), 1.0 / 256.0


def test_a_lost_tick_shifts_the_loops_time_against_the_count_of_syncs():
    box = Mailbox(CONTEXT, 2)
    end = LoopEnd(box)
    for row in (0, 1, 2, 5, 6):  # two ticks were lost
        end.tell(row, row * PERIOD, np.zeros(2))
    assert box.loop_time(1.25 * PERIOD, PERIOD) == pytest.approx(1.25 * PERIOD)
    assert box.loop_time(3.5 * PERIOD, PERIOD) == pytest.approx(5.5 * PERIOD)
    assert np.isnan(box.loop_time(4.5 * PERIOD, PERIOD)), "of a row that has not been told"


def test_what_a_full_mailbox_has_no_place_for_is_counted_and_what_it_holds_is_whole():
    box = Mailbox(CONTEXT, 2)
    end = LoopEnd(box)
    for number in range(LETTERS + 3):
        box.send(Sighting(number, number, 0.1 * number, "phantom", np.zeros(2), np.full(9, number), np.eye(9)))
    assert end.lost == 3
    assert [(each.exposure_id, each.values[0]) for each in end.collect(0)] == [(k, k) for k in range(LETTERS)]
    box.send(Sighting(99, 99, 9.9, "phantom", np.zeros(2), np.zeros(9), np.eye(9)))
    assert [each.exposure_id for each in end.collect(1)] == [99] and end.lost == 3

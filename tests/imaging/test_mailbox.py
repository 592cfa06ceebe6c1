"""Between the loop and who looks at images: poses one way, sightings the other, and on emulated time at their hour."""

import multiprocessing
import threading

import numpy as np
import pytest

from hil.errors import UnusableInput
from hil.imaging.mailbox import LETTERS, POSES, LockstepEnd, LoopEnd, Mailbox, Sighting

PERIOD = 1.0 / 256.0


def mailbox():
    return Mailbox(multiprocessing.get_context("spawn"), 2)


def sighting(number, handled=None, kind="phantom"):
    size = 9 if kind == "phantom" else 6
    where = number if handled is None else handled
    return Sighting(number, where, 0.1 * number, kind, np.array([1.0, number]), np.arange(size) + number, np.eye(size) * (number + 1))


def same(one, two):
    scalars = (one.exposure_id, one.handled, one.time_s, one.kind) == (two.exposure_id, two.handled, two.time_s, two.kind)
    return scalars and all(np.array_equal(getattr(one, name), getattr(two, name)) for name in ("positions", "values", "covariance"))


def test_poses_are_interpolated_between_rows_that_are_there():
    box = mailbox()
    end = LoopEnd(box)
    assert box.pose_at(0.0, PERIOD) is None
    for row in range(POSES + 10):
        end.tell(row, row * PERIOD, np.array([row, -2.0 * row]))
    at = (POSES + 3.25) * PERIOD
    assert np.allclose(box.pose_at(at, PERIOD), [POSES + 3.25, -2.0 * (POSES + 3.25)], rtol=1e-12)
    for gone in (5.5, POSES + 9.5, -1.0):  # written over, not yet, before the run
        assert box.pose_at(gone * PERIOD, PERIOD) is None


def test_sightings_come_whole_once_and_in_their_order():
    box = mailbox()
    end = LoopEnd(box)
    sent = [sighting(k, kind=("phantom", "marker")[k % 2]) for k in range(LETTERS + 5)]
    for first in (0, 3):  # the places are used again
        for each in sent[first : first + 3]:
            box.send(each)
        taken = end.collect(0)
        assert len(taken) == 3 and all(same(*pair) for pair in zip(taken, sent[first : first + 3], strict=True))
    for each in sent:
        box.send(each)
        (one,) = end.collect(0)
        assert same(one, each)
    assert end.collect(0) == []


@pytest.mark.parametrize("early", [True, False])
def test_where_time_stands_still_an_image_comes_at_its_hour_however_fast_it_was_looked_at(early):
    """Of the first three the first two wait for the third, when the panel's clock is known."""
    box = mailbox()
    end = LockstepEnd(box, np.array([0.25, 0.5, 0.75, 1.0]), PERIOD)

    def look():
        box.handled()
        box.handled()
        for k in range(3):
            box.send(sighting(k, handled=2))
        box.handled()
        box.send(sighting(3))
        box.handled()

    thread = threading.Thread(target=look)
    if early:
        look()
    else:
        end.check = lambda: None if thread.ident else thread.start()  # only when the loop waits
    came = {row: [each.exposure_id for each in found] for row in range(300) if (found := end.collect(row))}
    assert came == {192: [0, 1, 2], 256: [3]}
    if not early:
        thread.join()


def test_a_loop_does_not_wait_for_who_has_gone():
    end = LockstepEnd(mailbox(), np.array([0.25]), PERIOD)

    def check():
        raise UnusableInput("the receiver ended")

    end.check = check
    assert end.collect(10) == []
    with pytest.raises(UnusableInput, match="the receiver ended"):
        end.collect(64)

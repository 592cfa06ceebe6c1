"""Buses that tests have opened are shut down when the test is over."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from lockstep_client import Master


@pytest.fixture(autouse=True)
def shut_down_buses() -> Iterator[None]:
    yield
    while Master.open:
        Master.open.pop().bus.shutdown()

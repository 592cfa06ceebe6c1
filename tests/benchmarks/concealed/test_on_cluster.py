"""Cases of the concealed benchmark on the fleet's engine are told what those in processes are, and a failing one costs no other."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import pytest
from concealed.making import Places
from fleet_jobs import FAILING, case

pytest.importorskip("distributed")


@pytest.mark.slow
def test_every_case_is_done_and_one_that_fails_is_said(tmp_path: Path) -> None:
    from concealed.on_cluster import LOCAL, each_on_cluster

    places = Places(tmp_path, "development")
    task = functools.partial(case, places, keep=True)
    rows: dict[int, Any] = {}
    said: list[str] = []
    each_on_cluster(task, [3, FAILING, 4], LOCAL, 1, rows.__setitem__, said.append)
    assert rows == {number: {"number": number, "keep": True, "places": repr(places)} for number in (3, 4)}
    assert [line for line in said if "dashboard" not in line] == [
        f"case {FAILING}: a fault of isocenter itself: RuntimeError('this case fails')"
    ]

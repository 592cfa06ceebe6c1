"""What a run of the checks says: for a person, by groups, and as JSON."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby

from hil.conform.all_checks import Conformance
from hil.conform.check import FAILED, PASSED, SKIPPED, Result
from hil.conform.wire import Frame

_MANY = 6
"""Checks of one group that ended alike for one reason are counted from this many on."""


def lines(found: Conformance) -> Iterator[str]:
    """Yield the report, line by line: what passed as a count, each failure with its frames, what was skipped and why."""
    for group, members in groupby(found.results, key=lambda result: result.group):
        results = list(members)
        counts = {kind: sum(1 for result in results if result.result == kind) for kind in (PASSED, FAILED, SKIPPED)}
        yield f"{'FAIL' if counts[FAILED] else 'PASS' if counts[PASSED] else 'skip'}  {group}: {_counted(counts)}"
        for result in results:
            if result.result == FAILED:
                yield from _failure(result)
        yield from _skipped([result for result in results if result.result == SKIPPED])
    yield ""
    for words in found.not_restored:
        yield f"not restored: {words}"
    if found.others:
        yield f"other nodes on the bus: {', '.join(map(str, found.others))}; what would reach them, too, was skipped"
    yield summary(found)


def summary(found: Conformance) -> str:
    """Return the last line."""
    counts = {kind: found.count(kind) for kind in (PASSED, FAILED, SKIPPED)}
    return f"node {found.node_id}: {len(found.results)} checks in {found.seconds:.0f} s: {_counted(counts)}"


def _counted(counts: dict[str, int]) -> str:
    words = {PASSED: "passed", FAILED: "failed", SKIPPED: "skipped"}
    return ", ".join(f"{number} {words[kind]}" for kind, number in counts.items() if number) or "none"


def _failure(result: Result) -> Iterator[str]:
    yield f"  FAIL  {result.check}  [{result.clause}]"
    yield f"        expected: {result.expected}"
    for frame in result.frames or ():
        yield f"        {frame}"
    if not any(not frame.sent for frame in result.frames):
        yield "        and nothing came"


def _skipped(results: list[Result]) -> Iterator[str]:
    by_reason: dict[str, list[Result]] = {}
    for result in results:
        by_reason.setdefault(result.reason, []).append(result)
    for reason, members in by_reason.items():
        if len(members) >= _MANY:
            yield f"  skip  {len(members)} checks: {reason}"
        else:
            yield from (f"  skip  {result.check}: {reason}" for result in members)


def document(found: Conformance) -> dict[str, object]:
    """Return the answer as JSON's own types."""
    return {
        "node": found.node_id,
        "passed": found.count(PASSED),
        "failed": found.count(FAILED),
        "skipped": found.count(SKIPPED),
        "seconds": round(found.seconds, 2),
        "other_nodes": list(found.others),
        "not_restored": list(found.not_restored),
        "checks": [
            {
                "group": result.group,
                "check": result.check,
                "clause": result.clause,
                "result": result.result,
                "expected": result.expected,
                "reason": result.reason,
                "frames": [_frame(frame) for frame in result.frames],
            }
            for result in found.results
        ],
    }


def _frame(frame: Frame) -> dict[str, object]:
    return {"time_s": frame.time_s, "id": frame.can_id, "data": frame.data.hex(" ").upper(), "sent": frame.sent, "remote": frame.remote}

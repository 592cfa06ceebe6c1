"""How many processes a diagnosis takes, and that its answer does not say how many."""

from __future__ import annotations

import pytest
from carriage import MACHINE, repeats

from hil.cli.app import main
from hil.diagnosis.diagnose import diagnose
from hil.errors import RecordingError
from hil.recording import write_recording


@pytest.mark.parametrize(
    ("processors", "words", "processes"), [({3}, (), 1), ({0, 5}, (), 2), (set(range(64)), (), 4), ({0, 5}, ("--jobs", "1"), 1)]
)
def test_one_process_per_processor_that_may_be_used_unless_said_otherwise(tmp_path, monkeypatch, processors, words, processes):
    paths = [str(tmp_path / f"{name}.csv") for name in ("one", "two")]
    for path, recording in zip(paths, repeats(2, duration_s=0.1).values(), strict=True):
        write_recording(recording, path)
    asked = []

    def ask(*_, jobs, **__):
        asked.append(jobs)
        raise RecordingError("enough")

    monkeypatch.setattr("hil.diagnosis.diagnose.diagnose", ask)
    monkeypatch.setattr("os.sched_getaffinity", lambda _: processors, raising=False)
    with pytest.raises(SystemExit):
        main(["diagnose", "emps", *paths, "-o", str(tmp_path / "answer"), *words])
    assert asked == [processes]


def test_the_answer_is_the_same_from_two_processes(friction, with_friction):
    two = diagnose(MACHINE, *with_friction, jobs=2)
    assert two.diagnosis.hypotheses == friction.diagnosis.hypotheses
    assert two.diagnosis.findings == friction.diagnosis.findings
    assert two.diagnosis.retuned == friction.diagnosis.retuned

"""What changed, as data."""

from __future__ import annotations

from typing import Any

import numpy as np

from hil.fleet.change.night_by_night import FleetChange
from hil.fleet.change.sentences import common_sentences, day, fleet_sentence, sentences
from hil.version import software_version


def document_of(found: FleetChange) -> dict[str, Any]:
    """Return the answer for JSON."""
    changes = [
        {
            "machine": each.machine,
            "task": each.parameter.task,
            "experiment": each.parameter.experiment,
            "quantity": each.parameter.quantity,
            "unit": each.parameter.unit,
            "kind": each.kind,
            "sigma": each.sigma,
            "alarm": day(each.alarm),
            "since": day(each.since),
            "since_ci95": [day(each.since_from), day(each.since_to)],
            "before": each.before,
            "now": each.now,
            "standard_deviation": each.deviation,
            "also": [other.quantity for other in each.also],
            "sentence": said,
        }
        for each, said in zip(found.changes, sentences(found), strict=True)
    ]
    return {
        "software": software_version(),
        "answer": fleet_sentence(found),
        "changes": changes,
        "common": common_sentences(found),
        "notes": list(found.notes),
        "machines": len(found.tracks.machines),
        "nights": [day(night) for night in found.tracks.nights[[0, -1]]],
        "parameters": int(np.sum(found.watched)),
        "threshold_sigma": found.threshold,
        "false_alarms_per_machine_year_stated": found.per_machine_year,
        "machine_years_watched": found.watched_years,
    }

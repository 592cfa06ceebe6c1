"""What changed on which machine: each night's results against the machine's own past and against what all machines share."""

from hil.fleet.change.night_by_night import Change, FleetChange, fleet_change
from hil.fleet.change.sentences import fleet_sentence, sentence
from hil.fleet.change.tracks import Parameter, Tracks, read_tracks
from hil.fleet.change.trend import Trend, trend_of

__all__ = ["Change", "FleetChange", "Parameter", "Tracks", "Trend", "fleet_change", "fleet_sentence", "read_tracks", "sentence", "trend_of"]

"""Recordings: one row per SYNC, as MDF4 or CSV, which survive a killed process."""

from hil.recording.between_rows import means_between_rows
from hil.recording.formats import convert, read_recording, write_recording
from hil.recording.framelog import FrameLog
from hil.recording.metadata import recording_metadata
from hil.recording.process import RecorderProcess
from hil.recording.recording import Channel, Recording
from hil.recording.sink import JournalSink
from hil.recording.warning import RecordingWarning

__all__ = [
    "Channel",
    "FrameLog",
    "JournalSink",
    "RecorderProcess",
    "Recording",
    "RecordingWarning",
    "convert",
    "means_between_rows",
    "read_recording",
    "recording_metadata",
    "write_recording",
]

"""Identification of frequency responses from recordings: Chapters 3 and 4. Pure functions from arrays or recordings to result objects."""

from hil.identification.bla import fast_bla, robust_bla
from hil.identification.errors import IdentificationError
from hil.identification.frf_file import read_frf, write_frf
from hil.identification.identify import METHODS, identify
from hil.identification.records import PeriodicRecords, periodic_records
from hil.identification.result import Distortion, FrequencyResponse

__all__ = [
    "METHODS",
    "Distortion",
    "FrequencyResponse",
    "IdentificationError",
    "PeriodicRecords",
    "fast_bla",
    "identify",
    "periodic_records",
    "read_frf",
    "robust_bla",
    "write_frf",
]

"""Fast local polynomial and rational method, LPM and LRM, at one pose (thesis Sec. 3.4.3): the nD method with a single pose."""

from __future__ import annotations

from hil.identification.local.local_model import LocalModel
from hil.identification.lpm_lrm.nd_lpm_lrm import ONE_POSE, nd_local
from hil.identification.records import PeriodicRecords
from hil.identification.result import FrequencyResponse


def fast_local(records: PeriodicRecords, model: LocalModel | None = None) -> FrequencyResponse:
    """Estimate the response with the fast LRM (LPM where `model.denominator` is 0).

    One experiment of one realisation suffices; any further ones are used too.

    Raises
    ------
    IdentificationError
        One period; windows that leave no degree of freedom, with those that would do.
    """
    return nd_local([records], model, ONE_POSE)[0]

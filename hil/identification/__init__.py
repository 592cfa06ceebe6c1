"""Identification of frequency responses from recordings: Chapters 3 and 4. Pure functions from arrays or recordings to result objects."""

from hil.errors import IdentificationError
from hil.identification.bla.fast_bla import fast_bla
from hil.identification.bla.robust_bla import robust_bla
from hil.identification.design.excitation import ExcitationDesign, design_excitation
from hil.identification.design.frozen_pose import frozen_pose_check
from hil.identification.frf_file import read_frf, write_frf
from hil.identification.identify import ARBITRARY_METHODS, METHODS, POSE_METHODS, SELECTABLE, identify, identify_poses
from hil.identification.local.local_model import LocalModel
from hil.identification.lpm_lrm.arbitrary_lpm_lrm import ArbitraryRecords, arbitrary_local
from hil.identification.lpm_lrm.fast_lpm_lrm import fast_local
from hil.identification.lpm_lrm.nd_lpm_lrm import PoseModel, nd_local
from hil.identification.lpm_lrm.order_selection import Candidate, Selection, select_local_model
from hil.identification.lpm_lrm.pose_windows import PoseSymmetry
from hil.identification.lpm_lrm.robust_lpm_lrm import robust_local
from hil.identification.modal.lpv_model import ModalFrfModel, fit_modal_model
from hil.identification.modal.resonances import Resonance, Resonances, resonances
from hil.identification.records import PeriodicRecords, periodic_records
from hil.identification.result import Distortion, FrequencyResponse

__all__ = [
    "ARBITRARY_METHODS",
    "METHODS",
    "POSE_METHODS",
    "SELECTABLE",
    "ArbitraryRecords",
    "Candidate",
    "Distortion",
    "ExcitationDesign",
    "FrequencyResponse",
    "IdentificationError",
    "LocalModel",
    "ModalFrfModel",
    "PeriodicRecords",
    "PoseModel",
    "PoseSymmetry",
    "Resonance",
    "Resonances",
    "Selection",
    "arbitrary_local",
    "design_excitation",
    "fast_bla",
    "fast_local",
    "fit_modal_model",
    "frozen_pose_check",
    "identify",
    "identify_poses",
    "nd_local",
    "periodic_records",
    "read_frf",
    "resonances",
    "robust_bla",
    "robust_local",
    "select_local_model",
    "write_frf",
]

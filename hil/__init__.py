"""The bench: machine file, clock, sample loop, experiments, recordings, identification, diagnosis, reports, command line.

`import hil` is the front door for Python: open a machine, run an experiment, and identify, simulate, observe or diagnose what was recorded.

    import hil

    carm = hil.open_machine("carm")
    recordings = carm.run(hil.Multisine(periods=2, realisations=2), bus="lockstep:")
    frf = hil.identify(recordings)

Importing it loads nothing else: each name is loaded when it is first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from controllers.excitation_lines import Band as Band
    from hil.calibration.kinematic.geometric_model import GeometricModel as GeometricModel
    from hil.calibration.kinematic.geometric_model import write_model as write_model
    from hil.calibration.use.lookup_table import LookUp as LookUp
    from hil.calibration.use.lookup_table import read_look_up as read_look_up
    from hil.calibration.use.lookup_table import write_look_up as write_look_up
    from hil.diagnosis.result import Diagnosis as Diagnosis
    from hil.errors import BadAnswerError as BadAnswerError
    from hil.errors import BenchError as BenchError
    from hil.errors import ExperimentError as ExperimentError
    from hil.errors import LoopAbortedError as LoopAbortedError
    from hil.errors import MachineFileError as MachineFileError
    from hil.errors import RecordingError as RecordingError
    from hil.errors import UnusableInputError as UnusableInputError
    from hil.experiments import Experiment as Experiment
    from hil.experiments import Jog as Jog
    from hil.experiments import JogOnly as JogOnly
    from hil.experiments import Move as Move
    from hil.experiments import Multisine as Multisine
    from hil.experiments import Scan as Scan
    from hil.experiments import Static as Static
    from hil.experiments import Tour as Tour
    from hil.experiments import read_experiment as read_experiment
    from hil.experiments import write_experiment as write_experiment
    from hil.fleet.file import Fleet as Fleet
    from hil.fleet.file import read_fleet as read_fleet
    from hil.fleet.new_work import FleetRun as FleetRun
    from hil.fleet.new_work import run_fleet as run_fleet
    from hil.fleet.status import fleet_status as fleet_status
    from hil.fleet.store import query_fleet as query_fleet
    from hil.identification import FrequencyResponse as FrequencyResponse
    from hil.identification import LocalModel as LocalModel
    from hil.identification import PoseModel as PoseModel
    from hil.identification import read_frf as read_frf
    from hil.identification import resonances as resonances
    from hil.identification import write_frf as write_frf
    from hil.imaging.scan_folder import ImageScan as ImageScan
    from hil.imaging.scan_folder import read_scan as read_scan
    from hil.machine import Machine as Machine
    from hil.machine import list_shipped as list_shipped
    from hil.observing import Estimate as Estimate
    from hil.observing import ObserverDesign as ObserverDesign
    from hil.observing import read_design as read_design
    from hil.observing import read_estimate as read_estimate
    from hil.observing import write_design as write_design
    from hil.observing import write_estimate as write_estimate
    from hil.recording import Channel as Channel
    from hil.recording import Recording as Recording
    from hil.recording import RecordingWarning as RecordingWarning
    from hil.recording import read_recording as read_recording
    from hil.recording import write_recording as write_recording
    from hil.shaping.choice import ShaperChoice as ShaperChoice
    from hil.shaping.shaper_file import ShaperFile as ShaperFile
    from hil.shaping.shaper_file import read_shaper as read_shaper
    from hil.shaping.shaper_file import write_shaper as write_shaper
    from hil.simulation import Comparison as Comparison
    from hil.verbs.calibrate import calibrate_model as calibrate_model
    from hil.verbs.calibrate import calibrate_phantom as calibrate_phantom
    from hil.verbs.calibrate_data import DataCalibration as DataCalibration
    from hil.verbs.calibrate_data import calibrate_data as calibrate_data
    from hil.verbs.commission import Commissioning as Commissioning
    from hil.verbs.commission import commission as commission
    from hil.verbs.compare import compare as compare
    from hil.verbs.diagnose import diagnose as diagnose
    from hil.verbs.expose import expose as expose
    from hil.verbs.identify import identify as identify
    from hil.verbs.identify import identify_all_poses as identify_all_poses
    from hil.verbs.machine import OpenMachine as OpenMachine
    from hil.verbs.machine import open_machine as open_machine
    from hil.verbs.observe import design_observer as design_observer
    from hil.verbs.observe import observe as observe
    from hil.verbs.plot import plot as plot
    from hil.verbs.recordings import Recordings as Recordings
    from hil.verbs.recordings import recording_from_frame as recording_from_frame
    from hil.verbs.shape import shape as shape
    from hil.verbs.simulate import simulate as simulate

_MODULES = {
    "controllers.excitation_lines": "Band",
    "hil.calibration.kinematic.geometric_model": "GeometricModel write_model",
    "hil.calibration.use.lookup_table": "LookUp read_look_up write_look_up",
    "hil.diagnosis.result": "Diagnosis",
    "hil.errors": "BadAnswerError BenchError ExperimentError LoopAbortedError MachineFileError RecordingError UnusableInputError",
    "hil.experiments": "Experiment Jog JogOnly Move Multisine Scan Static Tour read_experiment write_experiment",
    "hil.fleet.file": "Fleet read_fleet",
    "hil.fleet.new_work": "FleetRun run_fleet",
    "hil.fleet.status": "fleet_status",
    "hil.fleet.store": "query_fleet",
    "hil.identification": "FrequencyResponse LocalModel PoseModel read_frf resonances write_frf",
    "hil.imaging.scan_folder": "ImageScan read_scan",
    "hil.machine": "Machine list_shipped",
    "hil.observing": "Estimate ObserverDesign read_design read_estimate write_design write_estimate",
    "hil.recording": "Channel Recording RecordingWarning read_recording write_recording",
    "hil.shaping.choice": "ShaperChoice",
    "hil.shaping.shaper_file": "ShaperFile read_shaper write_shaper",
    "hil.simulation": "Comparison",
    "hil.verbs.calibrate": "calibrate_model calibrate_phantom",
    "hil.verbs.calibrate_data": "DataCalibration calibrate_data",
    "hil.verbs.commission": "Commissioning commission",
    "hil.verbs.compare": "compare",
    "hil.verbs.diagnose": "diagnose",
    "hil.verbs.expose": "expose",
    "hil.verbs.identify": "identify identify_all_poses",
    "hil.verbs.machine": "OpenMachine open_machine",
    "hil.verbs.observe": "design_observer observe",
    "hil.verbs.plot": "plot",
    "hil.verbs.recordings": "Recordings recording_from_frame",
    "hil.verbs.shape": "shape",
    "hil.verbs.simulate": "simulate",
}
"""Where each name is: the imports above, for programs."""

_HOMES = {name: module for module, names in _MODULES.items() for name in names.split()}

__all__ = list(_HOMES)


def __getattr__(name: str) -> object:
    """Load a name when it is first used."""
    if name not in _HOMES:
        raise AttributeError(f"module 'hil' has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(_HOMES[name]), name)
    return value


def __dir__() -> list[str]:
    """Return the names of the front door."""
    return sorted(_HOMES)

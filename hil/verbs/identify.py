"""Frequency responses from recordings, one for each pose, and the resonances in them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Self, cast

from hil.errors import RequestError
from hil.verbs.errors import as_bench_errors
from hil.verbs.verb import EMULATED, KEPT, NOBODY, Listener, argument, option

if TYPE_CHECKING:
    import numpy as np

    from hil.identification import FrequencyResponse, LocalModel, PoseModel, Resonances
    from hil.identification.from_recordings import PlantInput
    from hil.machine import Machine
    from hil.recording import Recording
    from hil.verbs.recordings import Several

PLANT_INPUTS = ("command", "measured")


@dataclass(frozen=True)
class OverAxis:
    """Orders and windows over one axis along which poses vary, and where along it the machine responds alike [rad or m]."""

    numerator: int
    denominator: int
    windows: int
    mirrors: tuple[float, ...] = ()
    period: float | None = None


@dataclass(frozen=True)
class IdentifyRequest:
    """What is identified from recordings, or their files, and how: the parts are those of `identify_all_poses`."""

    recordings: Several = argument("All experiments and realisations of one pose or more.", "REC...")
    out: Path | None = option(
        "Where to write (.npz); of several poses, each gets its number in its name.", "FRF", "-o", "--out", is_needed=True
    )
    method: str = option(
        "robust_bla, fast_bla, robust_lpm, robust_lrm, fast_lpm, fast_lrm, nd_lpm, nd_lrm (neighbouring poses help), "
        "arbitrary_lpm, arbitrary_lrm (any excitation).",
        None,
        "--method",
        default="robust_bla",
    )
    model: LocalModel | tuple[int, int, int] | None = option(
        "Orders of response, transient and denominator; 2,2,1 unless given.", "N_n,N_m,N_d", "--orders"
    )
    over_poses: PoseModel | Sequence[OverAxis] | None = option(
        "Orders over the poses and levels to either side, for each axis that varies; SYMMETRY, where the machine responds alike: "
        "mirror@90deg, period@360deg, or in m.",
        "Q_n,Q_d,P[,SYMMETRY]",
        "--over-poses",
        is_several=True,
    )
    select: bool = option("Choose orders and windows from the data (fast and nd methods).", None, "--select", default=False)
    band_Hz: tuple[float, float] | None = option("Excited band [Hz], for the arbitrary methods.", "LOW:HIGH", "--band")
    plant_input: str = option("From the command the loop computed, or the measured effort.", None, "--input", default="command")
    outputs: Sequence[str] | None = None
    machine: Machine | None = None


@dataclass(frozen=True)
class ChannelAnswer:
    """An input or an output."""

    name: str
    """Its channel."""
    unit: str
    """Its unit."""


@dataclass(frozen=True)
class ResonanceAnswer:
    """A vibrating mode."""

    frequency_Hz: float
    """Undamped natural frequency."""
    frequency_ci95_Hz: tuple[float, float]
    """Its lower and upper bound at 95 %."""
    damping: float
    """Damping ratio."""
    damping_ci95: tuple[float, float]
    """Its bounds."""
    output: str
    """Output of the element in which the mode stands out most."""
    input: str
    """Input of it."""


@dataclass(frozen=True)
class ResponseAnswer:
    """The frequency response of one pose, and its resonances."""

    frf: Path | None
    """The file that was written. Of several poses the answer is `{"poses": [one of these per pose]}`."""
    emulated: bool
    """Whether a recording was made on the emulator."""
    modes: tuple[ResonanceAnswer, ...]
    """Resonances that the response supports, rising."""
    modes_method: str
    """How they were found."""
    modes_misfit: float
    """What their fit leaves in units of the noise's variance; null without one."""
    no_modes: str
    """Why there are none."""
    method: str
    """How the response was estimated."""
    settings: Mapping[str, object]
    """Of the method."""
    notes: tuple[str, ...]
    """What a user should know."""
    inputs: tuple[ChannelAnswer, ...]
    """What excites."""
    outputs: tuple[ChannelAnswer, ...]
    """What responds."""
    lines: np.ndarray
    """Excited lines."""
    frequencies_Hz: np.ndarray
    """Their frequencies."""
    magnitude: np.ndarray
    """(lines, outputs, inputs) of the response."""
    phase_rad: np.ndarray
    """(lines, outputs, inputs) of the response."""
    noise_standard_deviation: np.ndarray | None
    """(lines, outputs, inputs) of each complex element, by noise."""
    total_standard_deviation: np.ndarray | None
    """(lines, outputs, inputs) of each complex element, by noise and distortion."""
    response: FrequencyResponse = field(metadata=KEPT, repr=False)
    resonances: Resonances = field(metadata=KEPT, repr=False)

    @classmethod
    def of(cls, path: Path | None, emulated: bool, response: FrequencyResponse, modes: Resonances) -> Self:
        """Return what is told of a response and its resonances."""
        import numpy as np

        from hil.identification.modal.resonances import METHOD

        found = (
            ResonanceAnswer(each.frequency_Hz, each.frequency_ci95_Hz, each.damping, each.damping_ci95, each.output, each.input)
            for each in modes.found
        )
        inputs = zip(response.input_names, response.input_units, strict=True)
        outputs = zip(response.output_names, response.output_units, strict=True)
        return cls(
            path,
            emulated,
            tuple(found),
            METHOD,
            modes.misfit,
            modes.reason,
            response.method,
            response.settings,
            tuple(response.notes),
            tuple(ChannelAnswer(*each) for each in inputs),
            tuple(ChannelAnswer(*each) for each in outputs),
            response.lines,
            response.frequencies_Hz,
            np.abs(response.G),
            np.angle(response.G),
            None if response.noise_covariance is None else response.standard_deviation("noise"),
            None if response.total_covariance is None else response.standard_deviation("total"),
            response,
            modes,
        )

    @property
    def title(self) -> str:
        """Where and how the response was measured."""
        axes = [each.name.partition("_")[2] for each in self.inputs]
        told = f"{self.method}, {len(self.lines)} lines" + (f", pose {_pose(self.response)} in rad or m" if self.response.pose else "")
        return f"{EMULATED if self.emulated else ''}response to {', '.join(axes)}: {told}"


@dataclass(frozen=True)
class IdentifyAnswer:
    """A response for every pose."""

    poses: tuple[ResponseAnswer, ...]
    """One for each, in ascending order."""
    recordings: tuple[Recording, ...] = field(metadata=KEPT, repr=False)

    @property
    def document(self) -> object:
        """What JSON has of it: of one pose its response alone."""
        return self.poses[0] if len(self.poses) == 1 else self

    @property
    def lines(self) -> list[str]:
        """The answer in words."""
        from hil.identification.report import response_lines

        lines = []
        for each in self.poses:
            at = f", pose {_pose(each.response)}" if len(self.poses) > 1 else ""
            lines += [f"{each.frf}: {each.method} from {len(self.recordings)} recordings{at}"]
            lines += response_lines(each.response, each.resonances)
        return lines


def answer(request: IdentifyRequest, listener: Listener = NOBODY) -> IdentifyAnswer:
    """Estimate responses with their noise and distortion, find the resonances in them, and write the responses.

    Raises
    ------
    IdentificationError, RecordingError
        One line on what is wrong with the recordings or the method.
    UnusableInputError
        The request asks for what there is not, or a file cannot be written.
    """
    from hil.files.writable import can_be_written, not_an_input
    from hil.identification import resonances, write_frf
    from hil.verbs.recordings import each_of

    if request.out is not None:
        not_an_input(request.out, *(Path(each) for each in each_of(request.recordings) if isinstance(each, str | Path)))
        can_be_written(request.out, suffixes=(".npz",))
    read = _read(request)
    with listener.working("identifying"):
        responses = _identified(request, read)
        modes = [resonances(response) for response in responses]
    emulated = any(each.emulated for each in read)
    paths = [None] * len(responses) if request.out is None else _paths(request.out, len(responses))
    for path, response in zip(paths, responses, strict=True):
        if path is not None:
            write_frf(response, path)
    found = (ResponseAnswer.of(path, emulated, *each) for path, each in zip(paths, zip(responses, modes, strict=True), strict=True))
    return IdentifyAnswer(tuple(found), tuple(read))


@as_bench_errors()
def identify(
    recordings: Several,
    method: str = "robust_bla",
    *,
    model: LocalModel | None = None,
    select: bool = False,
    band_Hz: tuple[float, float] | None = None,
    outputs: Sequence[str] | None = None,
    plant_input: PlantInput = "command",
    machine: Machine | None = None,
) -> FrequencyResponse:
    """Identify the frequency response matrix of one pose, with covariances.

    Parameters
    ----------
    recordings : Recording, Recordings or several of them
        All experiments and realisations of one pose.
    method : str
        One of `hil.identification.METHODS`, or of `ARBITRARY_METHODS` with a band.
    model : LocalModel, optional
        Orders and windows of a local method.
    select : bool
        Choose them from the data instead.
    band_Hz : (low, high), optional
        Excited band, for the arbitrary methods.
    outputs : sequence of str, optional
        Channels; motor positions and accelerations unless given.
    plant_input : "command" or "measured"
    machine : Machine, optional
        For recordings that do not carry theirs.

    Returns
    -------
    FrequencyResponse
        `.G` (lines, outputs, inputs) over `.frequencies_Hz`, `.bound()`, and `.control`, a `control.FRD`.

    Raises
    ------
    IdentificationError, RecordingError
        One line on what is wrong with the recordings or the method; recordings are of several poses.

    Examples
    --------
    A turntable that answers as a known filter does is found to be that filter.

    >>> import hil
    >>> import numpy as np
    >>> from scipy.signal import freqz, lfilter
    >>> (plan,) = hil.Multisine(period_s=2.0, periods=2, jog=None).plans(hil.open_machine("turntable"))
    >>> command = plan.excitation[:, 0]
    >>> answered = lfilter([0.1], [1.0, -0.9], command)
    >>> signals = {"time": ("s", np.arange(plan.rows) / 200.0), "excitation_turn": ("A", command), "command_turn": ("A", command)}
    >>> signals["position_turn"] = ("rad", answered)
    >>> recording = hil.Recording({name: hil.Channel(*each) for name, each in signals.items()}, {"experiment": plan.metadata})
    >>> frf = hil.identify(recording, "fast_bla")
    >>> bool(np.allclose(frf.G[:, 0, 0], freqz([0.1], [1.0, -0.9], worN=frf.frequencies_Hz, fs=200.0)[1]))
    True
    """
    from hil.identification import IdentificationError

    found = identify_all_poses(
        recordings, method, model=model, select=select, band_Hz=band_Hz, outputs=outputs, plant_input=plant_input, machine=machine
    )
    if len(found) > 1:
        poses = ", ".join(_pose(each) for each in found)
        raise IdentificationError(f"recordings of {len(found)} poses: {poses}; identify_all_poses returns a response for each")
    return found[0]


@as_bench_errors()
def identify_all_poses(
    recordings: Several,
    method: str = "robust_bla",
    *,
    model: LocalModel | None = None,
    over_poses: PoseModel | None = None,
    select: bool = False,
    band_Hz: tuple[float, float] | None = None,
    outputs: Sequence[str] | None = None,
    plant_input: PlantInput = "command",
    machine: Machine | None = None,
) -> tuple[FrequencyResponse, ...]:
    """Identify a frequency response matrix for every start pose that recordings have, in ascending order.

    Parameters
    ----------
    recordings, method, model, select, band_Hz, outputs, plant_input, machine
        As `identify`; method also `nd_lpm` or `nd_lrm`, in which neighbouring poses help.
    over_poses : PoseModel, optional
        Orders and windows over the poses for these.

    Raises
    ------
    IdentificationError, RecordingError
    """
    request = IdentifyRequest(recordings, None, method, model, over_poses, select, band_Hz, plant_input, outputs, machine)
    return _identified(request, _read(request))


def _read(request: IdentifyRequest) -> list[Recording]:
    from hil.simulation import in_effort
    from hil.verbs.recordings import every_one

    if request.plant_input not in PLANT_INPUTS:
        raise RequestError("{plant_input} {}: must be {}", request.plant_input, " or ".join(PLANT_INPUTS))
    read = list(every_one(request.recordings, machine=request.machine).values())
    return [in_effort(each, request.machine) for each in read] if request.plant_input == "command" else read


def _identified(request: IdentifyRequest, read: Sequence[Recording]) -> tuple[FrequencyResponse, ...]:
    from hil.identification import LocalModel, PoseModel, PoseSymmetry, identify_poses

    over_poses = request.over_poses
    if over_poses is not None and not isinstance(over_poses, PoseModel):
        numerator, denominator, windows = zip(*((each.numerator, each.denominator, each.windows) for each in over_poses), strict=True)
        symmetry = tuple(PoseSymmetry(each.mirrors, each.period) for each in over_poses)
        over_poses = PoseModel(numerator, denominator, windows, symmetry=symmetry)
    return identify_poses(
        read,
        request.method,
        model=LocalModel(*request.model) if isinstance(request.model, tuple) else request.model,
        over_poses=over_poses,
        select=request.select,
        band_Hz=request.band_Hz,
        outputs=request.outputs,
        plant_input=cast("PlantInput", request.plant_input),
    )


def _paths(out: Path, poses: int) -> list[Path]:
    """Return `out` itself for one pose, `carm_p1.frf.npz` and so on for more."""
    if poses == 1:
        return [out]
    stem, dot, rest = out.name.partition(".")
    return [out.with_name(f"{stem}_p{index + 1}{dot}{rest}") for index in range(poses)]


def _pose(response: FrequencyResponse) -> str:
    return f"({', '.join(f'{value:.4g}' for value in response.pose)})"

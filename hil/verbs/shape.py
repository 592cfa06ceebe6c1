"""Reference shapers: designed for one axis, judged, and one of them chosen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from hil.verbs.errors import as_bench_errors
from hil.verbs.verb import EMULATED, KEPT, NOBODY, POSE, Listener, option

if TYPE_CHECKING:
    from hil.identification import FrequencyResponse
    from hil.machine import Machine
    from hil.shaping.aim import Aim
    from hil.shaping.choice import ShaperChoice
    from hil.shaping.in_time import InTime
    from hil.shaping.verdict import Verdict
    from virtual_bus.linear.left_out import LeftOut


@dataclass(frozen=True)
class ShapeRequest:
    """Shapers of one axis of a machine."""

    machine: Machine
    axis: str = option("Axis whose reference is shaped.", None, "--axis", kind=str, is_needed=True)
    out: Path | None = option("Where to write the shaper (.npz).", "SHAPER", "-o", "--out", is_needed=True)
    pose: Mapping[str, float] | None = option(POSE, "AXIS=VALUE,...", "--pose")
    period_s: float | None = option("Period of a scan that repeats; 0 for a sweep.", "S", "--period", kind=float, none=0.0)
    harmonics: Sequence[int] = option("Of the period: tracked without error.", "N,N,...", "--harmonics", default=(1, 3, 5))
    longest_s: float | None = option("Longest transient; 0.6 s for a sweep, one period otherwise.", "S", "--longest", kind=float, none=0.0)
    schedule: str = option("Design over the range of this axis and interpolate.", "AXIS", "--schedule", default="")
    output: str = option("What shall track: link, detector or motor.", None, "--output", default="link")
    frf: FrequencyResponse | str | Path | None = option("Design from an identified frequency response.", "FRF", "--frf")
    quiet_Hz: tuple[float, float] = option("Band [Hz] that the quiet design passes least in.", "LOW:HIGH", "--quiet", default=(4.0, 20.0))
    also: Sequence[str] = option("Designs beside the usual ones: shortest, dc, zpetc, zmetc.", "NAME,...", "--also", default=())
    take: str = option("Write this design instead of the recommended one.", "NAME", "--take", default="")

    @property
    def inputs(self) -> list[Path]:
        """Files that are read."""
        return [Path(self.frf)] if isinstance(self.frf, str | Path) else []


@dataclass(frozen=True)
class StepAnswer:
    """A loop after a step of its reference."""

    left: float
    """Largest ringing in the output after the shaper's transient, as a share of the step."""
    settled_s: float
    """When it is down to a twentieth of that without a shaper."""
    overshoot: float
    """Over the step, as a share of it."""
    ramp_lag_s: float
    """By which a ramp is trailed."""


@dataclass(frozen=True)
class ShapeAnswer:
    """All designs judged, and the one that was chosen."""

    shaper: Path | None
    """The file that was written."""
    chosen: str
    """The design that was written."""
    recommended: str
    """The recommended design."""
    fit: bool
    """Nothing is against running the design that was written; otherwise the exit status is 1."""
    machine: str
    """Name of the machine."""
    hash: str
    """Of its file."""
    aim: Aim
    """The design goal."""
    source: str
    """What the designs are for, in words."""
    output: str
    """What shall track."""
    verdict: str
    """Of the design that was written, in words."""
    in_time: Mapping[str, StepAnswer]
    """A step of the reference `without` a shaper and `shaped`."""
    left_out: tuple[LeftOut, ...]
    """Effects of the machine file that the linear model of this answer does not hold."""
    designs: tuple[Verdict, ...]
    """One verdict per design, the recommended one first; vibration and tracking error are shares."""
    refused: Mapping[str, str]
    """Design to the reason why there is none."""
    not_simulated: str
    """Why no moves were simulated; empty where they were, or for a frequency response."""
    choice: ShaperChoice = field(metadata=KEPT, repr=False)
    steps: Mapping[str, InTime] = field(metadata=KEPT, repr=False)
    request: ShapeRequest = field(metadata=KEPT, repr=False)

    @property
    def sentence(self) -> str:
        """The answer in a sentence."""
        axis, verdict, against = self.choice.axis, self.choice.chosen.verdict, self.choice.chosen.verdict.against
        if against and self.chosen == self.recommended:
            return f"No design for {axis} of {self.machine} is fit to run: the best is {self.chosen}, and against it is: {against}."
        if against:
            return f"{self.chosen} is not fit to run on {axis} of {self.machine}: {against}. Recommended is {self.recommended}."
        less = f"leaves {100.0 * verdict.vibration_at_10:.2g} % of the linear loop's vibration with modes 10 % off"
        if (residual := verdict.residual) is not None:
            low, high = (f"{share:.0f}" if share >= 10.0 else f"{share:.2g}" for share in (100.0 * residual.low, 100.0 * residual.high))
            less = f"leaves {low} to {high} % of the vibration, as simulated,"
        beside = "" if self.chosen == self.recommended else f"; recommended is {self.recommended}"
        return f"{self.chosen} for {axis} of {self.machine} {less} and takes {verdict.transient_s:.3f} s{beside}."

    @property
    def lines(self) -> list[str]:
        """The rest in words."""
        from hil.shaping.in_time import in_time_lines
        from hil.shaping.report import design_lines, left_out_lines, outside_lines

        choice, (low, high) = self.choice, self.request.quiet_Hz
        poses = len(choice.subjects.each)
        return [
            f"{self.aim.kind} of {choice.axis}, from {self.source}",
            *design_lines(choice.candidates, choice.chosen),
            *left_out_lines(choice.chosen),
            *in_time_lines(self.steps["none"], self.steps[self.chosen], self.chosen),
            *outside_lines(self.left_out),
            f"the quiet design keeps {low:g} to {high:g} Hz low; modes are sought over the whole band of the loop",
            f"{self.shaper}: {self.chosen}, {len(choice.chosen.filters[0].gains)} taps, {poses} pose{'s' if poses > 1 else ''}",
        ]


def answer(request: ShapeRequest, listener: Listener = NOBODY) -> ShapeAnswer:
    """Design, judge and write a shaper.

    Raises
    ------
    UnusableInputError
        Parts of the request do not go together, or a file cannot be read or written.
    DesignError
        Nothing can be designed for this loop.
    """
    from hil.files.writable import can_be_written, not_an_input
    from hil.shaping.in_time import after_step, settled
    from hil.shaping.shaper_file import write_shaper

    if request.out is not None:
        not_an_input(request.out, *request.inputs)
        can_be_written(request.out, suffixes=(".npz",))
    choice = choose(request, listener)
    if request.out is not None:
        write_shaper(choice.file, request.out)
    chosen, rate = choice.chosen, request.machine.sample_rate_Hz
    dynamics = choice.subjects.each[0].dynamics
    steps = {each.name: after_step(dynamics, each.filters[0], rate) for each in (choice.candidates.named("none"), chosen)}
    pair = steps["none"], steps[chosen.name]
    told = (StepAnswer(each.left, settled_s, each.overshoot, each.ramp_lag_s) for each, settled_s in zip(pair, settled(*pair), strict=True))
    return ShapeAnswer(
        request.out,
        chosen.name,
        choice.designs[0].name,
        not chosen.verdict.against,
        request.machine.name,
        request.machine.hash,
        choice.aim,
        choice.notes["source"],
        request.output,
        chosen.verdict.line,
        dict(zip(("without", "shaped"), told, strict=True)),
        choice.outside,
        tuple(design.verdict for design in choice.designs),
        choice.candidates.refused,
        choice.candidates.not_simulated,
        choice,
        steps,
        request,
    )


def choose(request: ShapeRequest, listener: Listener = NOBODY) -> ShaperChoice:
    """Design and judge shapers, and choose one; raises as `answer` does."""
    from hil.identification import read_frf
    from hil.shaping.aim import periodic, sweep
    from hil.shaping.choice import check_request, choose_shaper

    check_request(request.machine, request.axis, request.schedule, request.pose or {}, request.frf is not None)
    longest = {} if request.longest_s is None else {"longest_transient_s": request.longest_s}
    aim = sweep(**longest) if request.period_s is None else periodic(request.period_s, request.harmonics, request.longest_s)
    frf = read_frf(request.frf) if isinstance(request.frf, str | Path) else request.frf
    with listener.working("designing"):
        choice = choose_shaper(
            request.machine,
            request.axis,
            pose=request.pose,
            frf=frf,
            aim=aim,
            schedule=request.schedule,
            output=request.output,
            quiet_Hz=request.quiet_Hz,
            also=request.also,
            take=request.take,
        )
    source = f"{EMULATED if frf is not None and frf.emulated else ''}{_source(choice, request.frf)}"
    return replace(choice, notes={**choice.notes, "source": source})


@as_bench_errors()
def shape(
    machine: Machine,
    axis: str,
    *,
    pose: Mapping[str, float] | None = None,
    frf: FrequencyResponse | None = None,
    period_s: float | None = None,
    harmonics: Sequence[int] = (1, 3, 5),
    longest_s: float | None = None,
    schedule: str = "",
    output: str = "link",
    also: Sequence[str] = (),
) -> ShaperChoice:
    """Design reference shapers for one axis, judge them, and choose the recommended one.

    Parameters
    ----------
    machine : Machine
    axis : str
    pose : mapping, optional
        Positions by axis name [rad or m] at which the machine file's closed loop is taken; axes left out stand at zero.
    frf : FrequencyResponse, optional
        Design from this identified response instead.
    period_s : float, optional
        Period of a scan that repeats; for a sweep none.
    harmonics : sequence of int
        Of the period: tracked without error.
    longest_s : float, optional
        Longest transient; 0.6 s for a sweep and one period otherwise, unless given.
    schedule : str
        Design over the whole range of this axis, and interpolate.
    output : "link", "detector" or "motor"
        What shall track.
    also : sequence of str
        Designs beside the usual ones: "shortest", the shortest delay; "dc", "zpetc", "zmetc", zeros of the path inverted.

    Returns
    -------
    ShaperChoice
        For `machine.run(..., shaper=...)`; `.frame()` has the verdicts of all designs, `.control` the chosen one as a
        `control.TransferFunction`, and `.named("ZVD")` chooses another.

    Raises
    ------
    UnusableInputError, DesignError

    Examples
    --------
    A turntable whose encoder shows a resonance at 8 Hz: what is chosen takes less than a second, and ends where its reference does.

    >>> import hil
    >>> import numpy as np
    >>> from scipy.signal import lfilter
    >>> turntable = hil.open_machine("turntable")
    >>> (plan,) = hil.Multisine(period_s=2.0, periods=4, jog=None).plans(turntable)
    >>> command = plan.excitation[:, 0]
    >>> answered = lfilter([0.0, 1e-3], [1.0, -1.888, 0.9505], command)
    >>> signals = {"time": ("s", np.arange(plan.rows) / 200.0), "excitation_turn": ("A", command), "command_turn": ("A", command)}
    >>> signals["position_turn"] = ("rad", answered)
    >>> recording = hil.Recording({name: hil.Channel(*each) for name, each in signals.items()}, {"experiment": plan.metadata})
    >>> choice = hil.shape(turntable, "turn", frf=hil.identify(recording, "fast_bla"), output="motor")
    >>> bool(choice.chosen.name != "none"), float(choice.shaper.gains.sum().round(6)), choice.shaper.transient_samples < 200
    (True, 1.0, True)
    """
    return choose(ShapeRequest(machine, axis, None, pose, period_s, harmonics, longest_s, schedule, output, frf, also=also))


def _source(choice: ShaperChoice, frf: FrequencyResponse | str | Path | None) -> str:
    """Return in words what the shapers are designed for, positions in degrees (mm)."""
    machine, subjects = choice.machine, choice.subjects
    if subjects.poses is None:
        return f"{frf if isinstance(frf, str | Path) else 'an identified frequency response'}, fitted to {subjects.fit_error:.2%}"
    poses = [[value / units.edge for units, value in zip(machine.units, pose, strict=True)] for pose in subjects.poses]
    if not subjects.schedule:
        where = ", ".join(f"{name} {value:g}" for name, value in zip(machine.axes, poses[0], strict=True))
        return f"the machine file's closed loop at {where}"
    low, high = (poses[k][machine.axis_index(subjects.schedule)] for k in (0, -1))
    return f"the machine file's closed loop at {len(poses)} poses, {subjects.schedule} {low:g} to {high:g}"

"""isocenter identify: frequency responses from recordings, and the resonances in them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil.cli.emulated import say_emulated
from hil.cli.options import can_be_written, load, not_an_input, parse_band
from hil.cli.paged import PageOption, check_page, write_paged
from hil.terminal.output import Answer, JsonOption, save_figure
from hil.terminal.progress import working

if TYPE_CHECKING:
    from hil.identification import FrequencyResponse, LocalModel, PoseModel, PoseSymmetry
    from hil.identification.from_recordings import PlantInput

POSE_UNITS = {"deg": math.pi / 180.0, "m": 1.0}


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(
        short_help="Frequency responses from recordings.",
        help="Identify the frequency response matrix, with covariances, from recordings of one pose or, pose by pose, of several; and the"
        " resonances that it supports: frequency, damping ratio and 95 % bounds."
        "\n\nExample:  isocenter identify run_*.mf4 -o carm.frf.npz --figure carm.png"
        "\n\nNeighbouring poses helping:  isocenter identify pose*.mf4 --method nd_lrm --orders 3,2,1 --over-poses 1,1,2 -o carm.frf.npz",
    )(identify)


def identify(
    recordings: Annotated[list[Path], typer.Argument(metavar="REC...", help="All experiments and realisations of one pose or more.")],
    out: Annotated[
        Path, typer.Option("-o", "--out", metavar="FRF", help="Where to write (.npz); of several poses, each gets its number in its name.")
    ],
    method: Annotated[
        str,
        typer.Option(
            "--method",
            help="robust_bla, fast_bla, robust_lpm, robust_lrm, fast_lpm, fast_lrm, nd_lpm, nd_lrm (neighbouring poses help), "
            "arbitrary_lpm, arbitrary_lrm (any excitation).",
        ),
    ] = "robust_bla",
    orders: Annotated[
        str, typer.Option("--orders", metavar="N_n,N_m,N_d", help="Orders of response, transient and denominator; 2,2,1 unless given.")
    ] = "",
    over_poses: Annotated[
        list[str] | None,
        typer.Option(
            "--over-poses",
            metavar="Q_n,Q_d,P[,SYMMETRY]",
            help="Orders over the poses and levels to either side, for each axis that varies; SYMMETRY, where the machine responds alike: "
            "mirror@90deg, period@360deg, or in m.",
        ),
    ] = None,
    select: Annotated[bool, typer.Option("--select", help="Choose orders and windows from the data (fast and nd methods).")] = False,
    band: Annotated[str, typer.Option("--band", metavar="LOW:HIGH", help="Excited band [Hz], for the arbitrary methods.")] = "",
    plant_input: Annotated[str, typer.Option("--input", help="From the command the loop computed, or the measured effort.")] = "command",
    figure: Annotated[Path | None, typer.Option("--figure", metavar="PNG", help="Draw it as well; of several poses the first.")] = None,
    machine_name: Annotated[
        str | None, typer.Option("--machine", "-m", metavar="M", help="Machine file, for a recording that carries none.")
    ] = None,
    page: PageOption = None,
    json_to: JsonOption = None,
) -> None:
    """Estimate frequency response, noise and nonlinear variance."""
    from hil.identification import identify_poses, resonances, write_frf
    from hil.identification.report import resonance_document, response_document, response_lines
    from hil.recording import read_recording
    from hil.simulation import in_effort

    machine = None if machine_name is None else load(machine_name)
    answer = Answer(json_to)
    not_an_input(out, *recordings)
    can_be_written(out, suffixes=(".npz",))
    can_be_written(figure)
    check_page(page)
    taken = _plant_input(plant_input)
    read = [read_recording(path, machine) for path in recordings]
    model, poses = _model(orders), _over_poses(over_poses or [])
    band_Hz = parse_band("--band", band) if band else None
    if taken == "command":
        read = [in_effort(each, machine) for each in read]
    with working("identifying"):
        responses = identify_poses(read, method, model=model, over_poses=poses, select=select, band_Hz=band_Hz, plant_input=taken)
        modes = [resonances(response) for response in responses]
    emulated = say_emulated(answer, dict(zip(recordings, read, strict=True)))
    documents = []
    for path, response, found in zip(response_paths(out, len(responses)), responses, modes, strict=True):
        write_frf(response, path)
        answer.say(
            f"{path}: {response.method} from {len(recordings)} recordings"
            + (f", pose {_pose(response.pose)}" if len(responses) > 1 else "")
        )
        for line in response_lines(response, found):
            answer.say(line)
        documents.append({"frf": path, "emulated": emulated, **resonance_document(found), **response_document(response)})
    if figure is not None:
        from hil.figures.frf import frf_figure

        save_figure(frf_figure(responses[0], modes=modes[0].found, title=_figure_title(responses[0], emulated)), figure)
        answer.say(f"{figure}: figure")
    if page is not None:
        from hil.reports.identified import identified_page

        write_paged(answer, identified_page(responses, modes, response_paths(out, len(responses)), recordings, read), page)
    answer.write(documents[0] if len(documents) == 1 else {"poses": documents})


def response_paths(out: Path, poses: int) -> list[Path]:
    """Return `out` itself for one pose, `carm_p1.frf.npz` and so on for more."""
    if poses == 1:
        return [out]
    stem, dot, rest = out.name.partition(".")
    return [out.with_name(f"{stem}_p{index + 1}{dot}{rest}") for index in range(poses)]


def _figure_title(response: FrequencyResponse, emulated: bool) -> str:
    """Return where and how the response was measured."""
    axes = [name.partition("_")[2] for name in response.input_names]
    at = ", ".join(f"{value:.4g}" for value in response.pose)
    told = f"{response.method}, {len(response.lines)} lines" + (f", pose ({at}) in rad or m" if response.pose else "")
    return f"{'EMULATED: ' if emulated else ''}response to {', '.join(axes)}: {told}"


def _pose(pose: tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in pose) + ")"


def _model(text: str) -> LocalModel | None:
    from hil.identification import LocalModel

    return LocalModel(*_whole_numbers("--orders", text, "N_n,N_m,N_d, such as 2,2,1")) if text else None


def _over_poses(texts: list[str]) -> PoseModel | None:
    from hil.identification import PoseModel

    if not texts:
        return None
    orders, symmetries = [], []
    for text in texts:
        parts = text.split(",")
        orders.append(_whole_numbers("--over-poses", ",".join(parts[:3]), "Q_n,Q_d,P, such as 1,1,2"))
        symmetries.append(_symmetry(parts[3:]))
    numerator, denominator, windows = zip(*orders, strict=True)
    return PoseModel(numerator, denominator, windows, symmetry=tuple(symmetries))


def _symmetry(parts: list[str]) -> PoseSymmetry:
    """Read mirror@90deg, any number of them, and at most one period@360deg."""
    from hil.identification import PoseSymmetry

    found: dict[str, list[float]] = {"mirror": [], "period": []}
    for part in parts:
        kind, _, place = part.strip().partition("@")
        unit = next((unit for unit in POSE_UNITS if place.endswith(unit)), None)
        try:
            value = float(place.removesuffix(unit or "")) * POSE_UNITS[unit or ""]
            found[kind].append(value)
        except (KeyError, ValueError):
            raise typer.BadParameter(f"--over-poses {part}: must be mirror@90deg or period@360deg, in deg or m") from None
    if len(found["period"]) > 1:
        raise typer.BadParameter("--over-poses: one period at most")
    return PoseSymmetry(tuple(found["mirror"]), found["period"][0] if found["period"] else None)


def _whole_numbers(option: str, text: str, form: str) -> tuple[int, int, int]:
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 3 or not all(part.isdecimal() for part in parts):
        raise typer.BadParameter(f"{option} {text}: must be three whole numbers {form}")
    first, second, third = map(int, parts)
    return first, second, third


def _plant_input(text: str) -> PlantInput:
    known: tuple[PlantInput, ...] = ("command", "measured")
    for name in known:
        if text == name:
            return name
    raise typer.BadParameter(f"--input {text}: must be command or measured")

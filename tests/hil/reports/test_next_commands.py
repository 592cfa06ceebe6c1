"""The command that a page says comes next is one that the command line takes, for a machine of the user's own as for a shipped one."""

from __future__ import annotations

import dataclasses
import shlex
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import typer

import hil
from hil.cli import register
from hil.cli.app import app
from hil.diagnosis.report.page import next_command
from hil.experiments.modest import middle_pose, modest_scan
from hil.identification.modal.resonances import resonances
from hil.machine import Machine, load_machine
from hil.machine.load import name_to_load
from hil.observing import Estimate
from hil.pages import Page
from hil.reconstruction.fdk import Volume
from hil.reconstruction.wire_profiles import WireQuality
from hil.reports.calibrated import data_page, marker_page, model_page, phantom_page
from hil.reports.identified import identified_page
from hil.reports.observed import observed_page
from hil.reports.plot import Plotted, plot_page
from hil.reports.reconstructed import reconstructed_page
from hil.reports.shaped import shaped_page
from hil.reports.spot import spot_page
from hil.shaping.choice import choose_shaper
from hil.shaping.in_time import after_step

ROWS = 64
NONE = np.zeros((ROWS, 0))


@pytest.fixture(scope="module")
def mine(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    """A file whose name is not that of the machine in it."""
    path = tmp_path_factory.mktemp("a user's") / "mine.toml"
    path.write_text(load_machine("turntable").text.replace('name = "turntable"', 'name = "arm"'))
    return load_machine(path)


@pytest.fixture(scope="module")
def command_line() -> Any:  # noqa: ANN401 - Typer's own copy of Click has no public types
    register.commands(app)
    return typer.main.get_command(app)


@pytest.fixture(scope="module")
def recorded(mine: Machine) -> hil.Recordings:
    multisine = hil.Multisine(period_s=4.0, periods=2, realisations=2, jog=hil.Jog(line=1))
    return cast("hil.Recordings", hil.open_machine(mine.path).run(multisine, bus="lockstep:"))


def parsed(command: Any, line: str) -> dict[str, Any]:  # noqa: ANN401
    """The values of a command's parameters; it is not run."""
    name, *words = shlex.split(line)
    assert name == "isocenter"
    context = None
    while True:
        context = command.make_context(name, words, parent=context)
        if not hasattr(command, "resolve_command"):
            return dict(context.params)
        name, command, words = command.resolve_command(context, [*context._protected_args, *context.args])


def shaped(machine: Machine) -> Page:
    choice = choose_shaper(machine, "roll")
    dynamics, shown = choice.subjects.each[0].dynamics, (choice.candidates.named("none"), choice.chosen)
    steps = {each.name: after_step(dynamics, each.filters[0], machine.sample_rate_Hz) for each in shown}
    facts = {"From": "the machine file"}
    return shaped_page(machine, "roll", "", choice.candidates, choice.chosen, choice.subjects.each, steps, Path("a.npz"), facts)


def observed(machine: Machine, recording: hil.Recording, out: str, design: Path | None) -> Page:
    names = [f"estimate_detector_{axis}{part}" for axis in ("x", "y", "z", "rx", "ry", "rz") for part in ("", "_variance")]
    names += [f"estimate_{name}" for name in ("nis", "measured", "alarm", "nis_window")]
    values = np.ones((ROWS, len(names)))
    estimate = Estimate(np.arange(ROWS) / 200.0, tuple(names), ("",) * len(names), values, (), NONE, (), NONE, "ukf", "")
    return observed_page(machine, estimate, recording, (Path("scan.mf4"), Path(out)), design, [])


def calibrated(machine: Machine, recording: hil.Recording) -> list[tuple[Page, str]]:
    """Pages of calibrations, each with the option by which the next command takes what was written."""
    nine, covariance = np.zeros((ROWS, 9)), np.tile(np.eye(9), (ROWS, 1, 1))
    good, time_s = np.ones(ROWS, dtype=bool), np.arange(ROWS) / 30.0
    files = (Path("images"), Path("written.npz"))
    fit = SimpleNamespace(good=good, residual_m=np.zeros(ROWS))
    table = SimpleNamespace(positions=time_s[:, None], axes=("turn",), deviation=nine, covariance=covariance)
    free = ("focal_u", "theta_x")
    marked = SimpleNamespace(good=good, free=free, residual_pixels=np.zeros(ROWS), values=nine, nominal=nine, covariance=covariance)
    found = SimpleNamespace(place_sigma_m=[1e-3, 1e-4], used=[1], refused=[], live=nine, covariance=covariance, final=nine)
    rms = dict.fromkeys(("position_m", "rotation_rad", "source_m"), 1.0)
    judged = {"a": {"held_out": True, "nominal": rms, "model": rms}}
    return [
        (phantom_page(machine, cast(Any, fit), cast(Any, table), files, []), "lookup"),
        (model_page(machine, judged, {"model": [nine]}, files[1], []), "lookup"),
        (data_page(machine, cast(Any, found), recording, files, []), "geometry"),
        (marker_page(machine, cast(Any, marked), cast(Any, SimpleNamespace(middle_s=time_s)), files, []), "marker"),
    ]


def test_shape_leads_to_a_scan_that_can_be_run(tmp_path: Path, command_line: Any) -> None:  # noqa: ANN401
    path = tmp_path / "mine.toml"
    path.write_text(load_machine("carm").text)
    machine = load_machine(path)
    values = parsed(command_line, shaped(machine).next_command)
    assert (values["machine_name"], values["axis"], values["shaper"]) == (str(path), "roll", Path("a.npz"))
    start, stop, speed = (np.radians(values[name]) for name in ("start", "stop", "speed"))
    assert hil.Scan("roll", start, stop, speed).plans(machine)[0].rows > ROWS


@pytest.mark.parametrize("name", ["carm", "turntable"])
def test_a_modest_scan_of_every_axis_can_be_run(name: str) -> None:
    machine = load_machine(name)
    for axis in machine.axes:
        (plan,) = modest_scan(machine, axis, middle_pose(machine, 0.0)).plans(machine)
        assert np.ptp(plan.reference[:, machine.axis_index(axis)]) > 0.1


def test_a_modest_scan_stays_within_a_range_that_hardly_reaches_beyond_zero(mine: Machine) -> None:
    (limit,) = mine.limits
    machine = dataclasses.replace(mine, limits=(dataclasses.replace(limit, lower=-0.1, upper=1.9),))
    scan = modest_scan(machine, "turn", middle_pose(machine, 0.0))
    assert (scan.start, scan.stop) == pytest.approx((-0.1, 0.7))


@pytest.mark.parametrize(
    ("out", "kept", "recording_file", "design"),
    [
        ("a.est.npz", Path("a.observer.npz"), "scan.mf4", "a.observer.npz"),
        ("a.est.npz", None, "scan.mf4", "DESIGN.npz"),
        ("estimated.mf4", None, "estimated.mf4", None),
    ],
)
def test_observe_leads_to_a_calibration_that_knows_the_observer(
    mine: Machine,
    recorded: hil.Recordings,
    command_line: Any,  # noqa: ANN401
    out: str,
    kept: Path | None,
    recording_file: str,
    design: str | None,
) -> None:
    values = parsed(command_line, observed(mine, recorded[0], out, kept).next_command)
    assert (values["machine_name"], values["recording_file"]) == (str(mine.path), Path(recording_file))
    assert values["design"] == (None if design is None else Path(design))


def test_calibrations_lead_to_what_takes_them(mine: Machine, recorded: hil.Recordings, command_line: Any) -> None:  # noqa: ANN401
    for page, option in calibrated(mine, recorded[0]):
        values = parsed(command_line, page.next_command)
        assert values["machine_name"] == str(mine.path)
        assert values[option] == Path("images" if option == "marker" else "written.npz")


def test_the_other_pages_lead_to_commands_on_this_machine(mine: Machine, recorded: hil.Recordings, command_line: Any) -> None:  # noqa: ANN401
    track = SimpleNamespace(
        spot_m=np.zeros((ROWS, 2)), sigma_m=np.ones(ROWS), time_s=np.arange(ROWS), spectrum=lambda: (np.ones(4), np.ones((4, 2)))
    )
    wire = WireQuality(20.0, 0.4, np.array([1e-3, 2.5e-3]), np.zeros(3), 0.02, np.eye(5), 1e-4)
    volume = Volume(np.zeros((8, 8, 8), dtype=np.float32), 1e-3, np.eye(3))
    pages = [
        spot_page(mine, cast(Any, track), None, Path("images"), []),
        reconstructed_page(mine, volume, {"wire": wire}, (Path("scan"), Path("out")), {"Geometry": "nominal geometry"}),
    ]
    for verdict in ("explained", "retuned", "misconfigured", "unknown_physics"):
        diagnosis: Any = SimpleNamespace(verdict=verdict, findings=[])
        pages.append(Page("", cast(Any, None), [], *next_command(diagnosis, name_to_load(mine), Path("a folder"))))
    separable: Any = SimpleNamespace(findings=[SimpleNamespace(separating_experiment=True)])
    pages.append(Page("", cast(Any, None), [], *next_command(separable, name_to_load(mine), Path("a folder"))))
    for page in pages:
        values = parsed(command_line, page.next_command)
        named = values.get("machine_name", str(mine.path))
        assert named in (str(mine.path), "a folder/machine.toml")


def test_pages_of_recordings_name_a_shipped_machine_and_no_other(mine: Machine, recorded: hil.Recordings, command_line: Any) -> None:  # noqa: ANN401
    shipped = cast("hil.Recording", hil.open_machine("turntable").run(hil.Static(1.0), bus="lockstep:"))
    response = hil.identify(recorded)
    for recordings, name in ((list(recorded), "MACHINE.toml"), ([shipped], "turntable")):
        paths = [Path("a.mf4")]
        page = identified_page([response], [resonances(response)], [Path("a.frf.npz")], paths, recordings)
        assert parsed(command_line, page.next_command)["machine_name"] == name
        other = recordings[0].part(slice(0, 200))
        moved = hil.Recording({**other.channels, "position_turn": hil.Channel("rad", other["position_turn"] + 1.0)}, other.metadata)
        page = plot_page([Plotted(paths[0], other, moved)], ["position_turn"])
        assert parsed(command_line, page.next_command)["machine_name"] == name
        assert parsed(command_line, plot_page([Plotted(paths[0], other)], ["position_turn"]).next_command)["simulate"]

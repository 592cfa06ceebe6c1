"""Claims of `isocenter identify` and `isocenter run multisine --design`: through the command line, over lockstep."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from page_text import page_text, page_verdict

from hil.cli.app import main
from hil.identification import read_frf
from hil.recording import read_recording

RUN = ("run", "multisine", "-m", "carm", "-b", "lockstep:", "--jog", "0", "--axes", "roll")


def isocenter(*arguments: Path | str) -> int:
    with pytest.raises(SystemExit) as left:
        main([str(argument) for argument in arguments])
    return left.value.code


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings at two poses, two seconds a period, and their frequency responses."""
    at = tmp_path_factory.mktemp("identify")
    for pose in (0, 20):
        run = (*RUN, "--pose", f"roll={pose}", "--period", "2", "--periods", "3", "--realisations", "2", "--band", "1:40", "--every-line")
        assert isocenter(*run, "-o", at / f"rec{pose}.csv") == 0
    assert (
        isocenter("identify", *sorted(at.glob("rec*.csv")), "-o", at / "carm.frf.npz", "--json", at / "bla.json", "--page", at / "bla.html")
        == 0
    )
    return at


@pytest.mark.nightly
def test_recordings_of_two_poses_give_two_responses(folder: Path) -> None:
    first, second = (read_frf(folder / f"carm_p{number}.frf.npz") for number in (1, 2))
    assert first.pose == (0.0, 0.0)
    assert second.pose == pytest.approx((0.0, np.radians(20.0)))
    assert len(json.loads((folder / "bla.json").read_text())["poses"]) == 2
    assert "from each motor to its own encoder known to 0.0" in page_verdict(folder / "bla.html")
    assert "at propeller 0°, roll 20°" in page_text(folder / "bla.html")
    assert first.settings["excitation_rms command_roll"] == pytest.approx(0.8, rel=0.01)


@pytest.mark.parametrize(
    ("options", "method"),
    [
        (("--method", "robust_lrm", "--orders", "2,1,1"), "robust_lrm"),
        (("--method", "fast_lpm", "--select"), "fast_lpm"),
        (("--method", "nd_lpm", "--orders", "3,2,0", "--over-poses", "1,0,1"), "nd_lpm"),
        (("--method", "nd_lrm", "--orders", "3,2,1", "--over-poses", "1,1,1,mirror@10deg"), "nd_lrm"),
    ],
)
def test_every_family_of_methods_agrees_with_the_average(folder: Path, options: tuple[str, ...], method: str, tmp_path: Path) -> None:
    """Within the two bounds, at lines where the response is not at the edge of the band."""
    assert isocenter("identify", *sorted(folder.glob("rec*.csv")), *options, "-o", tmp_path / "x.frf.npz") == 0
    found, average = read_frf(tmp_path / "x_p1.frf.npz"), read_frf(folder / "carm_p1.frf.npz")
    assert found.method == method
    position = found.output_names.index("position_roll")
    at = found.frequencies_Hz
    on_lines = np.interp(average.frequencies_Hz, at, np.abs(found.G[:, position, 0]))
    ratio = on_lines / np.abs(average.G[:, position, 0])
    assert np.median(ratio) == pytest.approx(1.0, abs=0.05)


@pytest.mark.slow
def test_a_designed_multisine_excites_what_the_responses_ask_for(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    design = [part for number in (1, 2) for part in ("--design", folder / f"carm_p{number}.frf.npz")]
    run = (*RUN, *design, "--design-lines", "30", "--period", "4", "--periods", "2", "--band", "1:40", "-o", tmp_path / "d.csv")
    assert isocenter(*run) == 0
    assert "frozen-pose check" in capsys.readouterr().out
    recording = read_recording(tmp_path / "d.csv")
    lines = np.array(recording.experiment["excited_lines"])
    assert len(lines) == 30
    assert np.all(lines % 2 == 1)
    spectrum = np.abs(np.fft.rfft(recording["excitation_roll"][:1024]))
    np.testing.assert_array_equal(np.flatnonzero(spectrum > 1e-3 * spectrum.max()), lines)
    assert np.ptp(spectrum[lines]) > 0.2 * spectrum[lines].max()  # weighted, not flat


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--method", "best"), "unknown method best; there are robust_bla"),
        (("--orders", "2,2"), "must be three whole numbers"),
        (("--orders", "2,2,1"), "robust_bla has no orders"),
        (("--select",), "orders cannot be selected for robust_bla"),
        (("--method", "arbitrary_lpm"), "needs the band"),
        (("--over-poses", "1,1,1"), "works pose by pose"),
        (("--band", "1"), "must be LOW:HIGH"),
        (("--method", "nd_lrm", "--over-poses", "1,1,1,mirror@90"), "mirror@90: must be mirror@90deg"),
    ],
)
def test_options_that_do_not_go_together_are_one_line(
    folder: Path, arguments: tuple[str, ...], says: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert isocenter("identify", *folder.glob("rec0*.csv"), *arguments, "-o", tmp_path / "x.npz") == 2
    said = capsys.readouterr().err
    assert says in said
    assert said.count("\n") == 1


@pytest.mark.nightly
def test_any_excitation_is_identified_from_one_long_period(folder: Path, tmp_path: Path) -> None:
    """Every bin excited: what an arbitrary method takes; a single record, started at rest."""
    run = (*RUN, "--pose", "roll=0", "--period", "16", "--periods", "1", "--settle-periods", "0", "--band", "0.5:45", "--every-line")
    assert isocenter(*run, "-o", tmp_path / "long.csv") == 0
    arguments = ("identify", tmp_path / "long.csv", "--method", "arbitrary_lrm", "--band", "1:40", "-o", tmp_path / "x.frf.npz")
    assert isocenter(*arguments) == 0
    found, average = read_frf(tmp_path / "x.frf.npz"), read_frf(folder / "carm_p1.frf.npz")
    position = found.output_names.index("position_roll")
    on_lines = np.interp(average.frequencies_Hz, found.frequencies_Hz, np.abs(found.G[:, position, 0]))
    assert np.median(on_lines / np.abs(average.G[:, position, 0])) == pytest.approx(1.0, abs=0.05)


def test_a_sparse_excitation_is_not_any_excitation(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ("identify", *folder.glob("rec0*.csv"), "--method", "arbitrary_lrm", "--band", "1:40", "-o", tmp_path / "x.npz")
    assert isocenter(*arguments) == 2
    assert "too little of it is excited" in capsys.readouterr().err


def test_a_design_the_response_does_not_cover_is_told(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = (*RUN, "--design", folder / "carm_p1.frf.npz", "--band", "0.1:90", "--period", "4", "-o", tmp_path / "d.csv")
    assert isocenter(*run) == 2
    assert "covers 1 to 40 Hz, not the band" in capsys.readouterr().err

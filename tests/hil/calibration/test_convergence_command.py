"""isocenter calibrate convergence: its tables, figure and rows along the runs, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hil.cli import main

CHAINS = Path(__file__).parents[3] / "benchmarks" / "chains"
DRAWING, BUILT = str(CHAINS / "table_2_1.toml"), str(CHAINS / "table_5_1.toml")
SHORT = ["--draws", "2", "--seconds", "5", "--image-rate", "4"]


def exit_of(*arguments: str) -> int:
    """Exit status of the command line."""
    with pytest.raises(SystemExit) as leave:
        main(list(arguments))
    return int(leave.value.code or 0)


@pytest.mark.nightly
def test_tables_figure_and_what_follows_the_withdrawal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, figure = tmp_path / "answer.json", tmp_path / "figure.png"
    command = ["calibrate", "convergence", DRAWING, "--true", BUILT, *SHORT, "--withdraw", "12", "--drift", "4"]
    assert exit_of(*command, "--figure", str(figure), "--json", str(out)) == 0
    answer = json.loads(out.read_text())
    assert answer["runs"] == 2
    assert answer["images"] == 12
    held = [row["held_out_m"] for row in answer["convergence"]]
    assert held[0] == pytest.approx(7.656e-3, rel=1e-3)  # Table 2.1 against Table 5.1
    assert held[-1] < 0.6e-3
    assert answer["parameters"]["beta_j3"]["true"] == 0.9910
    assert answer["parameters"]["delta_theta_j1"]["error_rms"] < 1e-3
    assert list(answer["curves"]) == ["a_j1", "delta_theta_j1", "alpha_j1", "d_j1"]
    assert answer["model_based"]["held_out_m"] < 2e-3
    last = answer["along"][-1]
    assert last["phantom_m"] < 0.2e-3
    assert last["frequency_share"] < 0.5 * last["frequency_start_share"]
    said = capsys.readouterr().out
    assert "images withdrawn after 12, frequencies fall by 4 %" in said
    assert figure.stat().st_size > 10_000


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--drift", "60"], "--drift 60: must be from 0 to 50 percent"),
        (["--seconds", "0"], "--seconds 0: must be a positive number"),
        (["--seconds", "2", "--image-rate", "0.5"], "hold two images at least"),
        (["--robustness", "--drift", "3"], "leave --withdraw and --drift out"),
    ],
)
def test_what_it_refuses(options: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_of("calibrate", "convergence", DRAWING, *options) == 2
    assert message in capsys.readouterr().err


def test_another_machine_s_file_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = tmp_path / "other.toml"
    other.write_text(Path(BUILT).read_text().replace('name = "j3"', 'name = "elbow"'))
    assert exit_of("calibrate", "convergence", DRAWING, "--true", str(other)) == 2
    assert "has joints j1, j2, elbow, j4; the drawing's are j1, j2, j3, j4" in capsys.readouterr().err

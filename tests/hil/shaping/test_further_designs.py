"""Designs that `--also` adds: the shortest delay, and zeros of the path inverted on the last tap, three ways."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from controllers.errors import DesignError
from controllers.settings import AxisLimits
from controllers.shapers.dynamics import Dynamics
from controllers.shapers.filter import ReferenceShaper
from controllers.shapers.zero_inversion import tail_of
from hil.cli import main
from hil.shaping.aim import periodic, sweep
from hil.shaping.plans import shaped
from hil.shaping.shaper_design import Candidates, design_all, shaper_of, subject
from hil.shaping.shaper_file import read_shaper

RATE = 200.0


@pytest.fixture(scope="module")
def path() -> Dynamics:
    """Return a mode at 8 Hz between an antiresonance at 5 Hz and a zero that has no stable inverse, at 200 Hz."""
    modes = np.polymul([1.0, 2 * 0.01 * 50.3, 50.3**2], [1.0, 60.0, 2500.0])
    zeros = np.polymul([1.0, 2 * 0.25 * 31.4, 31.4**2], [-1.0, 70.0])
    continuous = Dynamics.from_polynomials(zeros, modes)
    return continuous.scaled(1.0 / complex(continuous.response(0.0)).real).sampled(1.0 / RATE)


@pytest.fixture(scope="module")
def candidates(path: Dynamics) -> Candidates:
    return design_all([subject(path, [path])], periodic(2.0, (1, 3)), RATE, also=("shortest", "dc", "zpetc", "zmetc"))


def output(path: Dynamics, reference: np.ndarray) -> np.ndarray:
    state, out = np.zeros(len(path.a)), np.empty(len(reference))
    for k, value in enumerate(reference):
        out[k] = path.c @ state + path.d * value
        state = path.a @ state + path.b * value
    return out


@pytest.mark.parametrize("name", ["hTDF shortest", "hTDF dc", "hTDF zpetc", "hTDF zmetc"])
def test_each_tracks_its_harmonics_in_the_loop_once_it_has_settled(path: Dynamics, candidates: Candidates, name: str) -> None:
    """By the loop's own filter, sample by sample, and the plant's difference equations."""
    design = candidates.named(name)
    running = ReferenceShaper(("turn",), [shaper_of(design, "turn", RATE)], [AxisLimits("turn", -50.0, 50.0, 1e4, 1e6, 1e9, 10.0)], RATE)
    times = np.arange(1600) / RATE
    raw = np.sin(np.pi * times) - 0.3 * np.sin(3.0 * np.pi * times)
    reference, held = shaped(running, raw[:, None], np.zeros(1))
    assert held < 0
    error = output(path, reference[:, 0]) - raw
    assert np.abs(error[-400:]).max() < 1e-7
    assert np.abs(error).max() > 1e-3


def test_the_shortest_has_one_tap_fewer_between_samples_and_a_shorter_transient(candidates: Candidates) -> None:
    shortest, usual = (candidates.named(name).verdict.transient_s for name in ("hTDF shortest", "hTDF"))
    assert shortest < usual


def test_the_three_inverses_differ_by_the_zero_that_has_none(path: Dynamics) -> None:
    outside = next(zero for zero in path.zeros if zero.real > 1.0)
    s = 2j * np.pi * np.array([1.0, 3.0, 7.0])
    left = 1.0 - outside * np.exp(-s / RATE)
    tails = {method: tail_of(path, method)[0] for method in ("dc", "zpetc", "zmetc")}
    dc = tails["dc"].response(s)
    assert np.abs(tails["zmetc"].response(s) / dc * left) == pytest.approx(abs(1.0 - outside), rel=1e-9)  # no error of magnitude
    late = np.exp(s / RATE)  # zpetc looks one sample ahead
    assert np.angle(tails["zpetc"].response(s) / dc * left * late / (1.0 - outside)) == pytest.approx(0.0, abs=1e-9)


def test_an_inverse_of_many_close_zeros_is_stable_and_right() -> None:
    """Sixteen zeros near z = 1, as a closed loop has them: coefficients of one polynomial would move them outside the circle."""
    radii = 1.0 - np.geomspace(0.002, 0.07, 8)
    zeros = np.concatenate([radii * np.exp(1j * np.linspace(0.05, 0.6, 8)), radii * np.exp(-1j * np.linspace(0.05, 0.6, 8))])
    plant = Dynamics.from_polynomials(np.ones(1), [1.0, -0.5], 1.0 / RATE)
    tail, _ = tail_of(plant, "dc", zeros)
    assert tail is not None
    assert np.abs(np.linalg.eigvals(tail.a)).max() == pytest.approx(radii.max(), rel=1e-6)
    s = 2j * np.pi * np.array([0.3, 4.0, 20.0, 60.0])
    z = np.exp(s / RATE)[:, None]
    assert tail.response(s) == pytest.approx(np.prod((1.0 - zeros) / (1.0 - zeros / z), axis=1), rel=1e-6)


def test_a_schedule_and_an_unknown_name_are_refused(path: Dynamics) -> None:
    one = subject(path, [path])
    found = design_all([one, one], sweep(), RATE, also=("zmetc",))
    assert found.refused["hTDF zmetc"] == "it is made for one pose: leave out the schedule"
    with pytest.raises(DesignError, match="must be of shortest, dc, zpetc, zmetc"):
        design_all([one], sweep(), RATE, also=("zeros",))


@pytest.mark.nightly
def test_the_command_writes_the_design_that_is_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--axis", "roll", "--also", "shortest,zpetc", "--take", "hTDF shortest"]
    with pytest.raises(SystemExit) as left:
        main(["shape", "carm", *options, "-o", str(tmp_path / "a.npz"), "--json", "-"])
    assert left.value.code == 0
    answer = json.loads(capsys.readouterr().out)
    named = {design["name"]: design for design in answer["designs"]}
    assert named["hTDF shortest"]["transient_s"] < named["hTDF"]["transient_s"]
    assert named["hTDF zpetc"]["tracking"] < 1e-9
    assert read_shaper(tmp_path / "a.npz").shapers[0].name == "hTDF shortest"

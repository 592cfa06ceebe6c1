"""The focal spot on a machine at rest: drift and wobble as the emulated tube has them, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from bench_machines import CARM
from commands import isocenter
from page_text import page_verdict

from hil.calibration.marker.focal_spot import SpotTrack, spot_track
from hil.calibration.marker.image_quality import ImageQuality
from hil.errors import UnusableInputError
from hil.imaging.detector import Detector
from hil.imaging.geometry import ConeBeam
from hil.imaging.markers import PLATES
from hil.imaging.scan_folder import ImageScan
from hil.reports.spot import spot_charts, spot_page


def track(seconds: float = 8.0, rate: float = 30.0, wobble: float = 7e-6, anode: float = 48.3, drift: float = 8e-6) -> SpotTrack:
    time = np.arange(0.1, seconds, 1.0 / rate)
    averaged = wobble * np.sinc(anode * 0.008)
    along = averaged * np.sin(2.0 * np.pi * anode * time + 0.3) + drift * (1.0 - np.exp(-(time - 0.1) / 4.0))
    noise = np.random.default_rng(0).normal(0.0, 0.3e-6, (len(time), 2))
    return SpotTrack(time, np.column_stack([along, np.zeros(len(time))]) + noise, np.full((len(time), 2), 0.3e-6), 0.008)


def test_the_anode_shows_at_its_alias_with_its_own_amplitude() -> None:
    seen = track()
    alias, amplitude = seen.line(48.3)
    assert alias == pytest.approx(11.7)
    assert amplitude[0] == pytest.approx(7e-6, rel=0.03)
    assert amplitude[1] < 0.2e-6
    frequencies, amplitudes = seen.spectrum()
    assert frequencies[np.argmax(amplitudes[:, 0])] == pytest.approx(11.7, abs=0.13)
    assert seen.drift_m[0] == pytest.approx(8e-6 * (1.0 - np.exp(-7.8 / 4.0)), rel=0.1)


def test_its_page_marks_the_anodes_alias_and_says_how_far_it_moves() -> None:
    seen = track()
    page = spot_page(CARM, seen, 48.3, Path("still"), [])
    assert f"{1e6 * np.ptp(seen.spot_m[:, 0]):.1f} µm along columns" in page.verdict.text
    over_time, spectrum = spot_charts(seen, 48.3).cells
    assert spectrum.marks[0].x == pytest.approx(11.7)  # type: ignore[union-attr]
    assert np.allclose(over_time.series[1].y, 1e6 * seen.spot_m[:, 1])  # type: ignore[union-attr]


@pytest.mark.nightly
def test_the_command_measures_the_emulated_tube(tmp_path: Path) -> None:
    still = ["run", "static", "-m", "carm", "-b", "lockstep:", "--seconds", "1.2", "--truth", tmp_path / "t.csv", "-o", tmp_path / "r.mf4"]
    assert isocenter(*still) == 0
    shown = ["--truth", tmp_path / "t.csv", "--marker", "clinical", "--rate", "20", "-o", tmp_path / "images"]
    assert isocenter("expose", "carm", tmp_path / "r.mf4", *shown) == 0
    answers = ["--anode", "48.3", "--figure", tmp_path / "f.png", "--json", tmp_path / "a.json", "--page", tmp_path / "a.html"]
    assert isocenter("calibrate", "spot", "carm", tmp_path / "images", *answers) == 0
    answer = json.loads((tmp_path / "a.json").read_text())
    assert answer["anode_alias_Hz"] == pytest.approx(8.3, abs=0.01)
    assert answer["anode_wobble_m"][0] == pytest.approx(10e-6, rel=0.15)
    assert answer["anode_wobble_m"][1] < 1.5e-6
    assert (tmp_path / "f.png").stat().st_size > 10_000
    assert page_verdict(tmp_path / "a.html").startswith("The focal spot moves by")


def test_exposures_of_a_machine_that_moves_or_too_few_are_refused(tmp_path: Path) -> None:
    detector = Detector(64, 48, 1e-3)

    def scan(count: int, ends: float) -> ImageScan:
        places = np.column_stack([np.zeros(count), np.linspace(0.0, ends, count)])
        return ImageScan(
            tmp_path, detector, np.arange(count), 0.05 * np.arange(count), np.full(count, 8e-3), ("a", "b"), ("rad", "rad"), places, {}
        )

    beam = ConeBeam.from_parameters(np.zeros((1, 9)))
    for count, ends, line in ((15, 0.0, "needs 16 at least"), (20, 0.1, "the axes moved during the exposures")):
        with pytest.raises(UnusableInputError, match=line):
            spot_track(scan(count, ends), PLATES["clinical"](), beam, 0.25)


def test_an_exposure_that_is_blurred_or_noisy_stands_out() -> None:
    generator = np.random.default_rng(1)
    deviation, blur = 0.01 + generator.normal(0.0, 2e-4, 40), 1.2 + generator.normal(0.0, 0.01, (40, 2))
    assert ImageQuality(deviation, blur).suspects == []
    blur[7, 1] = 1.6
    deviation[20] = 0.014
    assert ImageQuality(deviation, blur).suspects == [7, 20]

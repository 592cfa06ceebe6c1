"""The page of every command that writes one, looked at in a browser on a wide and a narrow screen; pictures stay in build/screenshots."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from browser import WIDTHS
from commands import exposed_scan, isocenter
from page_text import page_verdict
from places import ROOT
from scans_to_reconstruct import scan_of

if TYPE_CHECKING:
    from playwright.sync_api import Page as Tab

pytestmark = pytest.mark.nightly

SCREENSHOTS = ROOT / "build" / "screenshots"
PAGES = ("demo", "plot", "identify", "shape", "observe", "diagnose", "faults", "phantom", "data", "model", "marker", "reconstruct")


class Maker:
    """Runs the commands, each once and only where a page needs it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.made: dict[str, Path] = {}

    def page(self, name: str) -> Path:
        """The page of a command; what it is made from is made first."""
        if name not in self.made:
            self.made[name] = getattr(self, f"_{name}")()
        return self.made[name]

    def _demo(self) -> Path:
        assert isocenter("demo", "--out", self.folder / "demo") == 0
        return self.folder / "demo" / "index.html"

    def _recordings(self) -> list[Path]:
        if not (found := sorted(self.folder.glob("carm_r*.mf4"))):
            shaken = ("--realisations", "3", "--period", "4", "--amplitude", "0.8")
            assert isocenter("run", "multisine", "-m", "carm", "-b", "lockstep:", *shaken, "-o", self.folder / "carm.mf4") == 0
            found = sorted(self.folder.glob("carm_r*.mf4"))
        return found

    def _plot(self) -> Path:
        out = self.folder / "plot.html"
        assert isocenter("plot", *self._recordings()[:2], "--simulate", "-o", out) == 0
        return out

    def _identify(self) -> Path:
        out = self.folder / "identify.html"
        assert isocenter("identify", *self._recordings(), "-o", self.folder / "carm.frf.npz", "--page", out) == 0
        return out

    def _shape(self) -> Path:
        out = self.folder / "shape.html"
        assert isocenter("shape", "carm", "--axis", "roll", "-o", self.folder / "roll.npz", "--page", out) == 0
        return out

    def _observe(self) -> Path:
        out = self.folder / "observe.html"
        assert isocenter("observe", "carm", self._recordings()[0], "-o", self.folder / "run.est.npz", "--page", out) == 0
        return out

    def _diagnose(self) -> Path:
        effects, repeats = self.folder / "rubs.toml", [self.folder / f"jog{seed}.mf4" for seed in (1, 2, 3)]
        effects.write_text('[[effect]]\nname = "viscous_friction"\nat = "turn"\nFv_Nm_s_rad = 5.0\n')
        for seed, path in enumerate(repeats):
            jog = ("--period", "4", "--periods", "1", "--seed", str(seed), "--effects", effects)
            assert isocenter("run", "jog", "-m", "turntable", "-b", "lockstep:", *jog, "-o", path) == 0
        assert isocenter("diagnose", "turntable", *repeats, "-o", self.folder / "diagnosis") in (0, 1)
        return self.folder / "diagnosis" / "report.html"

    def _faults(self) -> Path:
        only = ("--only", "torque_lost", "--only", "imu_silent")
        assert isocenter("faults", "check", "carm", "-o", self.folder / "faults", *only) in (0, 1)
        return self.folder / "faults" / "faults.html"

    def _scan(self) -> Path:
        if not (self.folder / "scan").exists():
            (self.folder / "scan").mkdir()
            exposed_scan(self.folder / "scan", "--scene", "dodecahedron", "--rate", "7")
        return self.folder / "scan"

    def _phantom(self) -> Path:
        out = self.folder / "phantom.html"
        table = self.folder / "roll.lookup.npz"
        assert isocenter("calibrate", "phantom", "carm", self._scan() / "images", "-o", table, "--page", out) == 0
        return out

    def _data(self) -> Path:
        out = self.folder / "data.html"
        files = (self._scan() / "scan.mf4", self._scan() / "images", "-o", self.folder / "scan.geometry.npz")
        assert isocenter("calibrate", "data", "carm", *files, "--page", out) == 0
        return out

    def _model(self) -> Path:
        out = self.folder / "model.html"
        self.page("phantom")
        table = self.folder / "roll.lookup.npz"
        assert isocenter("calibrate", "model", "carm", table, "-o", self.folder / "carm.model.npz", "--page", out) == 0
        return out

    def _marker(self) -> Path:
        out, folder = self.folder / "marker.html", self.folder / "marked"
        folder.mkdir()
        exposed_scan(folder, "--marker", "experimental", "--rate", "3")
        assert isocenter("calibrate", "marker", "carm", folder / "images", "-o", self.folder / "marker.npz", "--page", out) == 0
        return out

    def _reconstruct(self) -> Path:
        out = self.folder / "reconstruct.html"
        volume = ("-o", self.folder / "volume", "--size", "16")
        assert isocenter("reconstruct", "carm", scan_of(self.folder / "turn"), *volume, "--page", out) == 0
        return out


@pytest.fixture(scope="module")
def maker(tmp_path_factory: pytest.TempPathFactory) -> Maker:
    return Maker(tmp_path_factory.mktemp("every"))


@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_readable_on_a_wide_and_a_narrow_screen_and_in_print(maker: Maker, page: Tab, name: str) -> None:
    if name in ("phantom", "data", "model", "marker", "reconstruct"):
        pytest.importorskip("tifffile")
    if name == "reconstruct":
        pytest.importorskip("itk")
    path = maker.page(name)
    assert page_verdict(path)
    SCREENSHOTS.mkdir(parents=True, exist_ok=True)
    for width in WIDTHS.values():
        page.set_viewport_size({"width": width, "height": 900})
        page.goto(path.as_uri())
        if page.locator("figure.chart").count():
            page.wait_for_selector("html[data-drawn]", state="attached", timeout=30_000)
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        top = page.locator(".verdict").bounding_box()
        assert top is not None
        assert top["y"] < 250
        page.screenshot(path=SCREENSHOTS / f"{name}_{width}.png", full_page=True)
    page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
    page.emulate_media(media="print")
    assert page.locator("figure.chart canvas").count() == page.locator("figure.chart").count()
    assert (SCREENSHOTS / f"{name}_400.png").stat().st_size > 10_000

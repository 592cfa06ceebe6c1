"""The picture of the bench's page: the emulated C-arm, its roll moved by a held button, on the scope.

python docs/figures/bench-page.py; needs chromium.
"""

import tempfile
from pathlib import Path

from bench_page import bench_page
from browser import chromium

PICTURE = Path(__file__).with_suffix(".png")
PATIENCE_MS = 60_000.0

with tempfile.TemporaryDirectory() as folder, bench_page(Path(folder), "carm", "lockstep:", "--live") as bench, chromium() as browser:
    name, _, value = bench.cookie.partition("=")
    context = browser.new_context(viewport={"width": 1400, "height": 860})
    context.add_cookies([{"name": name, "value": value, "url": bench.address}])
    page = context.new_page()
    page.set_default_timeout(PATIENCE_MS)
    page.goto(f"{bench.address}/#scope")
    page.locator("#live-home:enabled").click()
    for label in ("command_propeller", "position_propeller", "imu_x", "imu_y", "imu_z"):
        page.get_by_label(label, exact=True).uncheck()
    page.get_by_label("reference_roll", exact=True).check()
    button = page.get_by_label("roll forward, while held")
    page.locator("#live-doing", has_text="Homed").wait_for()
    page.evaluate("scrollTo(0, 0)")
    box = button.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 10, box["y"] + 10)
    page.mouse.down()
    page.locator("#live-doing", has_text="moves for as long").wait_for()
    page.wait_for_timeout(3500)
    page.screenshot(path=PICTURE)
    page.mouse.up()

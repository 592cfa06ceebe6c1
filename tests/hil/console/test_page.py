"""The page of the bench in a real browser, against an emulated machine."""

from __future__ import annotations

import base64
import dataclasses
import functools
import json
import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from bench_page import BenchPage, Watcher, bench_page, until
from browser import WIDTHS, browser_or_skip, listen
from places import ROOT
from scipy.spatial.transform import Rotation

from hil.console.facts import facts_of
from hil.machine import load_machine

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page, Route

VIEWS = ("commission", "scope", "experiments", "state", "recordings")
STEP_MS = 240_000.0  # a step starts a process, on a computer that may be busy
AMPLITUDE_DEG, PERIOD_S = 2.0, 4.0


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[BenchPage]:
    browser_or_skip()
    with bench_page(tmp_path_factory.mktemp("bench"), "turntable", "lockstep:") as bench:
        yield bench


def let_in(page: Page, bench: BenchPage) -> None:
    name, _, value = bench.cookie.partition("=")
    page.context.add_cookies([{"name": name, "value": value, "url": bench.address}])


def opened(page: Page, bench: BenchPage, view: str) -> None:
    let_in(page, bench)
    page.goto(f"{bench.address}/#{view}")
    page.locator("#link", has_text="connected").wait_for(state="attached")  # a narrow page shows it only where it is lost


def fill_and_run(page: Page, form: str, **values: object) -> None:
    card = page.locator(f"[data-form={form}]")
    card.locator("summary").first.click()
    for name, value in values.items():
        card.locator(f"[name={name}]").fill(str(value))
    card.locator(".peak").first.wait_for(timeout=STEP_MS)
    assert "predicted peak command: turn" in card.locator(".peak").first.inner_text()
    card.locator("button.start:enabled").click(timeout=STEP_MS)


def ended(page: Page, state: str) -> str:
    page.locator(f"#now.{state}").wait_for(timeout=STEP_MS)
    return page.locator("#now").inner_text()


@pytest.fixture(scope="module")
def sine(browser: Browser, bench: BenchPage) -> None:
    """A jog, which the bench has recorded last when the first tests begin."""
    page = browser.new_page()
    opened(page, bench, "experiments")
    fill_and_run(page, "jog", jog=AMPLITUDE_DEG, period=PERIOD_S, periods=4)
    ended(page, "passed")
    page.close()


@pytest.mark.usefixtures("sine")
def test_the_scope_shows_a_sine_with_its_amplitude_and_frequency(page: Page, bench: BenchPage) -> None:
    opened(page, bench, "scope")
    page.get_by_label("reference_turn", exact=True).check()
    row = page.locator("tr[data-channel=reference_turn]")
    row.wait_for()
    page.locator("#scope-note", has_text="ended").wait_for()
    read = {what: float(row.locator(f"[data-what={what}]").get_attribute("data-value") or "nan") for what in ("amplitude", "frequency")}
    assert read["amplitude"] == pytest.approx(AMPLITUDE_DEG, rel=1e-3)
    assert read["frequency"] == pytest.approx(1.0 / PERIOD_S, rel=1e-3)
    assert page.locator(".pane[data-unit=deg] canvas").is_visible()
    assert re.search(r"recording began at \d\d:\d\d:\d\d", page.locator("#scope-note").inner_text())
    page.select_option("#angles", "rad")
    row.locator("td.text", has_text=re.compile("^rad$")).wait_for()
    assert float(row.locator("[data-what=amplitude]").get_attribute("data-value") or "nan") == pytest.approx(
        math.radians(AMPLITUDE_DEG), rel=1e-3
    )
    radians = page.locator(".pane[data-unit=rad]")
    assert radians.locator("canvas").is_visible()
    assert "current_turn" not in radians.locator(".legend").inner_text()
    page.locator("#channel-list label", has_text=re.compile("^current_turn$")).drag_to(radians)
    radians.locator(".legend", has_text="current_turn").wait_for()
    assert page.get_by_label("current_turn", exact=True).is_checked()


@pytest.mark.usefixtures("sine")
def test_a_trigger_holds_the_crossing_still_and_a_zoom_pauses(page: Page, bench: BenchPage) -> None:
    opened(page, bench, "scope")
    page.locator("#readout tr").first.wait_for(timeout=STEP_MS)
    page.get_by_label("reference_turn", exact=True).check()
    page.select_option("#span", "5")
    page.select_option("#trigger-channel", "reference_turn")
    page.select_option("#trigger-mode", "single")
    page.locator("#pause", has_text="Go on").wait_for()
    plot = page.locator(".pane .u-over").first
    box = plot.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 20)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 20, steps=4)
    page.mouse.up()
    page.locator("#scope-note", has_text="stands still").wait_for()
    page.get_by_label("Cursors").check()
    plot.click(position={"x": 0.25 * box["width"], "y": 40})
    plot.click(position={"x": 0.75 * box["width"], "y": 40})
    page.locator("#scope-note", has_text="B − A").wait_for()
    found = re.search(r"B − A = ([\d.]+) s", page.locator("#scope-note").inner_text())
    assert found
    assert float(found[1]) == pytest.approx(0.5 * 0.3 * 5.0, rel=0.05)


def test_stop_is_in_every_view_and_nothing_lies_over_it(browser: Browser, bench: BenchPage, console_errors: list[str]) -> None:
    for width in WIDTHS.values():
        page = browser.new_page(viewport={"width": width, "height": 800})
        listen(page, console_errors)
        for view in VIEWS:
            opened(page, bench, view)
            for down in (0, 10_000):
                page.mouse.wheel(0, down)
                stop, emulated = page.locator("#stop"), page.locator("#emulated")
                box = stop.bounding_box()
                assert box is not None
                assert box["x"] >= 0
                assert box["x"] + box["width"] <= width
                assert box["y"] >= 0
                middle = [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2]
                assert page.evaluate("([x, y]) => document.elementFromPoint(x, y).closest('button')?.id", middle) == "stop"
                assert emulated.is_visible()
            assert page.evaluate("() => document.documentElement.scrollWidth <= innerWidth"), f"{view} is wider than {width} px"
        page.close()


def test_escape_stops_the_run(page: Page, bench: BenchPage) -> None:
    opened(page, bench, "experiments")
    fill_and_run(page, "static", seconds=36000)
    page.locator("#now", has_text="recording static").wait_for(timeout=STEP_MS)
    page.locator("[data-form=static] [name=seconds]").focus()  # even while something is written
    page.keyboard.press("Escape")
    said = ended(page, "stopped")
    assert "the motors were stopped" in said
    assert "STOP in a browser" in said


def test_a_stop_whose_request_is_refused_goes_over_the_line_that_keeps_the_motion(page: Page, bench: BenchPage) -> None:
    page.route("**/api/stop", lambda asked: asked.abort())
    opened(page, bench, "experiments")
    fill_and_run(page, "static", seconds=36000)
    page.locator("#now", has_text="recording static").wait_for(timeout=STEP_MS)
    page.locator("#stop").click()
    assert "STOP in a browser" in ended(page, "stopped")
    assert page.locator("#errors > div").count() == 0


def test_an_error_stays_until_it_is_dismissed(page: Page, bench: BenchPage) -> None:
    opened(page, bench, "recordings")
    page.locator("#plot").click()
    error = page.locator("#errors > div", has_text="choose recordings first")
    error.wait_for()
    page.locator("#stop").click()
    page.locator("#stop-answer", has_text="nothing runs here").wait_for()  # the state was told meanwhile
    assert error.is_visible()
    error.get_by_label("dismiss").click()
    assert page.locator("#errors > div").count() == 0


def test_a_stop_that_reaches_nobody_is_told_until_it_is_dismissed(page: Page, bench: BenchPage, console_errors: list[str]) -> None:
    page.route("**/worker.js", lambda asked: asked.fulfill(body="", content_type="text/javascript"))  # no line to the server
    page.route("**/api/stop", lambda asked: asked.abort())
    let_in(page, bench)
    page.goto(f"{bench.address}/#state")
    page.locator("#folder").filter(has_text=str(bench.folder)).wait_for(state="attached")
    page.keyboard.press("Escape")
    page.locator("#errors > div", has_text="did not reach the server").wait_for()
    console_errors[:] = [each for each in console_errors if "ERR_FAILED" not in each]


LINE = """
let doing = "ready";
const tell = (told) => postMessage(told);
onmessage = (event) => { if (event.data.doing) doing = event.data.doing; };
const state = STATE;
tell({ type: "welcome", client: "mine" });
setInterval(() => { state.live.told.doing = doing; tell(state); }, 50);
"""
"""A line over which a homed machine is told, and nothing reaches the server."""


@pytest.fixture
def jogged(page: Page, bench: BenchPage) -> Page:
    """The page of a homed machine; `orders` on it are what it has ordered."""
    watcher = Watcher(bench)
    state = watcher.state()
    watcher.close()
    axis = {"position": 0.1, "speed": 0.0, "effort": 0.0, "temperature_degC": 24.0, "brake": "closed", "mode": None, "drive": None}
    told = {"doing": "ready", "says": "", "homed": True, "axes": {"turn": axis}}
    state["live"] = {"running": True, "trouble": "", "told": told, "holds": False, "moves": False}
    body = LINE.replace("STATE", json.dumps(state | {"own": False}))
    page.route("**/worker.js", lambda asked: asked.fulfill(body=body, content_type="text/javascript"))
    page.route("**/api/bench", lambda asked: asked.fulfill(json=asked.fetch().json() | {"has_live": True}))
    page.add_init_script(
        "window.orders = []; const post = Worker.prototype.postMessage; Worker.prototype.postMessage = function (told) {"
        " window.line = this; if (told.move) orders.push(told.move); post.call(this, told); };"
    )
    let_in(page, bench)
    page.goto(f"{bench.address}/#state")
    page.get_by_label("turn forward, while held").and_(page.locator(":enabled")).wait_for()
    return page


AWAY = {
    "another window": "dispatchEvent(new Event('blur'))",
    "page left": "dispatchEvent(new Event('pagehide'))",
    "machine that takes no order": "line.postMessage({ doing: 'closing brakes' })",
    "hidden": "Object.defineProperty(document, 'hidden', { value: true }); document.dispatchEvent(new Event('visibilitychange'))",
}


def test_a_held_button_orders_again_and_again_until_it_is_left_in_whatever_way(jogged: Page) -> None:
    jogged.route("**/api/stop", lambda asked: asked.fulfill(json={}))
    forward, backward = (jogged.get_by_label(f"turn {way}, while held") for way in ("forward", "backward"))

    def left(order: str, leave: Callable[[], object], way: str) -> None:
        until(lambda: jogged.evaluate("orders.length > 3"), STEP_MS / 1e3)
        assert set(jogged.evaluate("orders")) == {order}, way
        leave()
        until(lambda: jogged.evaluate("orders.at(-1) === 'still'"), STEP_MS / 1e3)
        count = jogged.evaluate("orders.length")
        jogged.wait_for_timeout(250.0)
        assert jogged.evaluate("orders.splice(0).length") == count, f"{way}: it goes on by itself"
        jogged.evaluate("line.postMessage({ doing: 'ready' })")

    ways: dict[str, Callable[[], object]] = {
        "let go": jogged.mouse.up,
        "pointer elsewhere": lambda: jogged.mouse.move(3, 3),
        "Esc": lambda: jogged.keyboard.press("Escape"),
        **{way: functools.partial(jogged.evaluate, script) for way, script in AWAY.items()},
    }
    for way, leave in ways.items():
        forward.and_(jogged.locator(":enabled")).hover()
        jogged.mouse.down()
        left("jog turn 5", leave, way)
        jogged.mouse.up()
    for key, leave in ((" ", lambda: jogged.keyboard.up(" ")), ("Enter", lambda: jogged.keyboard.press("Tab"))):
        backward.and_(jogged.locator(":enabled")).focus()
        jogged.keyboard.down(key)
        left("jog turn -5", leave, key)
        jogged.keyboard.up(key)


AXIS = {"position": 0.1, "speed": 0.0, "effort": 1.5, "temperature_degC": 24.0, "brake": "open", "mode": None, "drive": "operation enabled"}
WORK = {
    "title": "At rest",
    "step": "static",
    "moves": True,
    "command": "still",
    "seconds": 3.0,
    "why": "",
    "holds": False,
    "progress": "",
    "lines": [],
    "made": [],
}
PASSED, STAGGERS = {"state": "passed", "why": "fine", "lines": []}, "turn: does not stand"


def of_machine(doing: str, part: str = "", remains_s: float | None = None, **axis: object) -> dict[str, object]:
    told = {"doing": doing, "part": part, "remains_s": remains_s, "says": "", "homed": doing not in ("watching", "homing"), "time_s": 1.0}
    return told | {"axes": {"turn": {**AXIS, **axis}}}


def told_page(page: Page, bench: BenchPage) -> Callable[..., None]:
    """A page at the commissioning whose line to the server is the caller's: it takes what is other than in a state at rest."""
    watcher = Watcher(bench)
    state = watcher.state()
    watcher.close()
    steps = {name: PASSED if name in ("check", "scan", "home") else {} for name in state["steps"]}
    live = {"running": False, "trouble": "", "told": None, "progress": "", "holds": False, "moves": False}
    state |= {"steps": steps, "stop": None, "recording": None, "own": True, "live": live}
    body = 'onmessage = (event) => event.data.fake && postMessage(event.data.fake); postMessage({ type: "welcome", client: "mine" });'
    page.route("**/worker.js", lambda asked: asked.fulfill(body=body, content_type="text/javascript"))
    plan = {"recordings": [{"rows": 2000, "seconds": 10.0, "notes": []}], "text": ""}
    page.route("**/api/preview", lambda asked: asked.fulfill(json=plan))
    page.add_init_script(
        "const post = Worker.prototype.postMessage;"
        " Worker.prototype.postMessage = function (told) { window.line = this; post.call(this, told); };"
    )
    page.route("**/api/bench", lambda asked: asked.fulfill(json=asked.fetch().json() | {"has_live": True}))
    let_in(page, bench)
    page.goto(f"{bench.address}/#commission")
    until(lambda: page.evaluate("Boolean(window.line)"), STEP_MS / 1e3)
    return lambda **other: page.evaluate("(told) => line.postMessage({ fake: told })", state | other)


@pytest.mark.parametrize("width", list(WIDTHS.values()))
def test_the_way_is_told_and_the_one_coloured_button_is_of_the_step_that_is_due(page: Page, bench: BenchPage, width: int) -> None:
    page.set_viewport_size({"width": width, "height": 900})
    tell = told_page(page, bench)
    now, coloured, brief = page.locator("#now"), page.locator(".main:visible"), page.locator("#brief")

    def told(work: dict[str, object], **other: object) -> str:
        tell(work=WORK | work, **other)
        page.locator(f"#now.{'stopped' if 'stop' in other else work['state']}").wait_for()
        return " ".join(now.inner_text().split())

    for doing, says in (
        (of_machine("homing", "turn, 1 of 1"), "Homing turn, 1 of 1: an axis is pushed"),
        (of_machine("on the way", remains_s=6.2, goes_to=0.3), "where it starts. It moves. turn 11.5° from it; 7 s to go"),
        (of_machine("coming to rest", remains_s=15.0), "waiting until it stands. 15 s at most"),
    ):
        assert says in told({"state": "running", "told": doing})
        assert says in page.locator("#live-doing").inner_text()
        assert "1.50 A" in brief.inner_text()
        assert "not homed" in brief.inner_text() or doing["doing"] != "homing"
        assert coloured.count() == 0
    drive: dict[str, object] = {"name": "turn_drive", "id": 1, "role": "drive", "axis": "turn", "nmt": "told by its rows", "emergency": ""}
    recording = {"name": "still.mf4", "rows": 800, "live": True, "began": "12:00:00", "experiment": "static"}
    assert "recording still.mf4: 800 rows, 4 of 10 s" in told(
        {"state": "running", "told": of_machine("recording", "still.mf4", 10.0, mode="torque")},
        recording=recording,
        newest={"position_turn": 0.1, "current_turn": 1.5},
        wire={"trouble": "one owner", "nodes": [drive | {"state": "operation enabled"}], "load": 0.0, "frames_Hz": 0.0, "sync_Hz": 0.0},
    )
    of_axis = " ".join(page.locator("[data-axis=turn]").inner_text().split())
    assert "brake open" in of_axis, "as the recording's beginning was told"
    assert "torque: operation enabled" in of_axis, "as its rows tell"
    passed, todo = ("check", "scan", "home"), ("identify", "shape", "observe")
    staggers = {"state": "bad", "why": STAGGERS, "lines": []}
    steps = {name: PASSED for name in passed} | {"static": staggers} | {name: {} for name in todo}
    faulty = {"running": True, "trouble": "", "told": of_machine("watching", drive="fault"), "holds": False, "moves": False}
    said = told({"state": "bad", "why": STAGGERS, "told": None}, steps=steps, live=faulty)
    assert STAGGERS in said
    assert "failed" not in said
    assert coloured.all_inner_texts() == ["Start again: the machine moves"]
    assert "nothing touches the arm" in page.locator("[data-step=static] .advice").inner_text()
    for view in VIEWS[1:]:
        page.locator(f"#tabs a[href='#{view}']").click()
        page.locator(f"#{view}").wait_for()
        assert coloured.all_inner_texts() == ["Next: 4. At rest"], "it leads to what is due, and moves nothing"
    coloured.click()
    page.locator("#commission").wait_for()
    assert coloured.all_inner_texts() == ["Start again: the machine moves"]
    assert "EMERGENCY turn: fault" in brief.inner_text()
    assert page.locator("[data-step=static] ul").evaluate("(list) => getComputedStyle(list).fontWeight") == "400", (
        "what it does is no error"
    )
    stop = {"by": "STOP in a browser", "lines": ["nothing runs here"], "seconds": 0.06, "trouble": "", "ran": False}
    assert told({"state": "bad", "why": STAGGERS, "told": None}, steps=steps, stop=stop) == "nothing runs here, 0.06 s after STOP", (
        "one event"
    )
    told({"state": "passed", "told": None}, steps={name: PASSED for name in steps})
    page.locator("#steps-done").wait_for()
    coloured.click()
    page.locator("#experiments").wait_for()  # its address has changed
    assert coloured.all_inner_texts() == ["Run: the machine moves"]
    assert page.locator("[data-form=static][open]").count() == 1
    assert page.evaluate("() => document.documentElement.scrollWidth <= innerWidth")


def test_what_a_command_says_of_its_progress_stands_in_the_bar(page: Page, bench: BenchPage) -> None:
    tell, share = told_page(page, bench), page.locator("#share")
    says = "diagnosing: 40 % after 12 s, about 18 s to go, compiling (once on a computer): 3 functions done, 20 left"
    tell(work=WORK | {"state": "running", "moves": False, "told": None, "progress": says})
    page.locator("#now", has_text=says).wait_for()
    assert share.evaluate("(bar) => bar.value") == pytest.approx(0.4)
    tell(work=WORK | {"state": "running", "moves": False, "told": None, "progress": "diagnosing: 240 s"})
    page.locator("#now", has_text="diagnosing: 240 s").wait_for()
    assert share.is_hidden(), "nothing was counted"


def test_angles_are_shown_and_taken_in_radians_on_request_and_the_plan_stays(page: Page, bench: BenchPage) -> None:
    tell = told_page(page, bench)
    live = {
        "running": True,
        "trouble": "",
        "progress": "",
        "told": of_machine("ready", position=0.1, speed=0.02),
        "holds": False,
        "moves": False,
    }
    steps = {name: PASSED for name in ("check", "scan", "home")} | {name: {} for name in ("static", "identify", "shape", "observe")}
    asked: list[float] = []

    def planned(route: Route) -> None:
        asked.append((route.request.post_data_json or {})["values"]["pose_turn"])
        route.fulfill(json={"recordings": [{"rows": 1, "seconds": 1.0, "notes": []}], "text": ""})

    page.route("**/api/preview", planned)
    tell(work={"state": "idle"}, steps=steps, live=live)
    place, card = page.locator("#live-axes .place"), page.locator("[data-step=static]")
    entry = card.locator("[name=pose_turn]")
    place.get_by_text("5.73°").wait_for()
    entry.fill("20")
    until(lambda: page.evaluate("1") and asked[-1:] == [20.0], STEP_MS / 1e3)
    page.select_option("#angles", "rad")
    assert place.inner_text() == "0.1000 rad"
    assert page.locator("#brief").inner_text().startswith("turn 0.1000 rad")
    assert page.locator("#live-axes [data-what=speed]").inner_text() == "0.020 rad/s"
    assert page.locator("#jog-speed option").first.inner_text() == "0.0175 rad/s"
    assert float(entry.input_value()) == pytest.approx(math.radians(20.0), rel=1e-9)
    assert entry.locator("xpath=..").inner_text().strip() == "rad"
    entry.fill("0.2")
    until(lambda: page.evaluate("1") and asked[-1] != 20.0, STEP_MS / 1e3)
    assert asked[-1] == pytest.approx(math.degrees(0.2), rel=1e-6)
    page.select_option("#angles", "deg")
    assert float(entry.input_value()) == pytest.approx(math.degrees(0.2), rel=1e-6)


def test_the_state_of_a_machine_that_is_connected_is_told_where_nothing_can_listen_beside(page: Page, bench: BenchPage) -> None:
    tell, devices = told_page(page, bench), page.locator("#devices")
    page.locator("#tabs a[href='#state']").click()
    told = of_machine("watching", brake="closed") | {"io": {"hold_to_run": False, "door_closed": True}}
    tell(work={"state": "idle"}, live={"running": True, "trouble": "", "told": told, "holds": False, "moves": False}, io=None)
    devices.get_by_text("released").wait_for()
    rows = [" ".join(text.split()) for text in devices.locator(".card", has_text="Brakes and I/O").locator("tr").all_inner_texts()]
    assert "turn closed 24.0 °C" in rows
    assert "door closed" in rows
    assert devices.get_by_text("silent").count() == 0, "nobody listens"
    assert devices.locator("[data-what=load]").inner_text() == "–"
    for speed, says in ((0.08, "moves for as long as its button is held"), (0.0004, "The drives hold")):
        holds = of_machine("holding", speed=speed)
        tell(work={"state": "idle"}, live={"running": True, "trouble": "", "told": holds, "holds": False, "moves": True})
        page.locator("#live-doing", has_text=says).wait_for()


def test_recordings_are_laid_over_each_other_aligned_and_with_what_is_derived(page: Page, bench: BenchPage) -> None:
    """The second is the first, seven tenths of a second later."""
    time = np.arange(0.0, 10.0, 0.01)
    for name, late_s in (("one", 0.0), ("two", 0.7)):
        phase = 0.6 * math.pi * (time - late_s)
        rows = np.column_stack((time, 0.2 * np.sin(phase), 0.1 * np.sin(phase), 2.0 * np.cos(phase)))
        head = "time [s],position_turn [rad],reference_turn [rad],current_turn [A]"
        np.savetxt(bench.folder / f"{name}.csv", rows, "%.9g", ",", header=head, comments="")
    opened(page, bench, "recordings")
    page.locator("tr.day", has_text=re.compile(r"\w+day, \d{4}-\d\d-\d\d")).first.wait_for()
    for name in ("one", "two"):
        page.get_by_label(f"train {name}.csv").check()
    assert "2 chosen, none held out" in page.locator("#chosen").inner_text()
    page.locator("#plot").click()
    panes = page.locator("#recorded-panes")
    degrees = panes.locator(".pane[data-unit=deg]")
    degrees.wait_for(timeout=STEP_MS)
    assert [" ".join(text.split()) for text in degrees.locator(".legend > span").all_inner_texts()] == [
        f"position_turn · {name}.csv" for name in ("one", "two")
    ]
    page.select_option("#align", "position_turn")
    page.locator("#recorded-note", has_text="shifted against one.csv: two.csv -0.700 s").wait_for(timeout=STEP_MS)
    page.locator("#recorded-channels label", has_text="current_turn").drag_to(degrees)
    degrees.locator(".legend", has_text="current_turn").wait_for(timeout=STEP_MS)
    for how, pane in (("difference", "deg"), ("derivative", "deg/s"), ("spectrum", "spectrum deg")):
        page.select_option("#derive-how", how)
        page.select_option("#derive-of", "position_turn")
        page.locator("#derive-add").click()
        panes.locator(f".pane[data-unit='{pane}'] .legend", has_text=re.compile(r"position_turn - |d\(|spectrum\(")).wait_for(
            timeout=STEP_MS
        )
    plot = degrees.locator(".u-over")
    plot.hover(position={"x": 200, "y": 50})
    values = degrees.locator(".legend > span", has_text="one.csv").locator("output").all_inner_texts()
    position, current, difference = map(float, values)
    assert difference == pytest.approx(0.5 * position, rel=1e-3)
    assert (position / math.degrees(0.2)) ** 2 + (current / 2.0) ** 2 == pytest.approx(1.0, abs=1e-3)


def test_no_rest_and_no_emergency_is_claimed_that_nobody_has_looked_for(page: Page, bench: BenchPage) -> None:
    tell, brief = told_page(page, bench), page.locator("#brief")
    begins = WORK | {"state": "running", "holds": True, "told": of_machine("watching")}
    tell(work=begins)
    page.locator("#release").wait_for()
    assert "nothing moves" not in page.locator("#now").inner_text()
    assert "no emergency" not in brief.inner_text(), "this bus has one owner"
    tell(work=begins, wire={"trouble": "", "nodes": []})
    brief.get_by_text("no emergency").wait_for()
    tell(work=begins | {"told": of_machine("stopping") | {"homed": False}})
    page.locator("#now", has_text="Stopping the motors").wait_for()
    assert "not homed" in brief.inner_text()


def test_drives_are_called_off_while_work_takes_over_only_where_all_say_so(page: Page, bench: BenchPage) -> None:
    tell, doing = told_page(page, bench), page.locator("#live-doing")
    off: dict[str, object] = {"drive": "switch on disabled (0250h)", "brake": "closed"}
    stop: dict[str, object] = {"by": "STOP in a browser", "lines": [], "seconds": None, "trouble": "", "ran": True}

    def stopping(axis: dict[str, object], holds: bool = False, **other: object) -> None:
        told = of_machine("stopping") | {"axes": {"turn": AXIS | axis}}
        live = {"running": True, "trouble": "", "progress": "", "told": told, "holds": holds, "moves": True}
        tell(work=WORK | {"state": "running", "told": None}, live=live, **other)

    for axis, holds, other in (
        ({"drive": "operation enabled (0237h)"}, False, {}),
        ({"drive": None}, False, {}),
        ({"brake": "open"}, False, {}),
        ({}, True, {}),
        ({}, False, {"stop": stop}),
    ):
        stopping(off | axis, holds, **other)
        doing.get_by_text("Stopping the motors").wait_for()
        stopping(off)
        doing.get_by_text("The drives are off, the brakes closed.").wait_for()


def test_what_cannot_be_derived_and_what_comes_late_spoil_no_plot(page: Page, bench: BenchPage) -> None:
    """The server's curves are the test's: of the file late.csv they wait until another was chosen."""
    late: list[Callable[[], None]] = []

    def answer(route: Route) -> None:
        asked: dict[str, list[str]] = route.request.post_data_json or {}
        value = 1.0 if asked["files"] == ["late.csv"] else 2.0
        packed = {axis: base64.b64encode(np.array([0.0, value]).tobytes()).decode() for axis in "xy"}
        curve = {"of": 0, "unit": "A", "kind": "time"} | packed
        found = [{"channel": text} | ({"of": 0, "error": "has 1 rows"} if "(" in text else curve) for text in asked["channels"]]
        told = {"channels": [["command_turn", "A"]], "shifts_s": [0.0], "curves": found}
        if value == 1.0 and asked["channels"]:
            late.append(functools.partial(route.fulfill, json=told))
        else:
            route.fulfill(json=told)

    for name in ("late", "next"):
        (bench.folder / f"{name}.csv").write_text("time [s],command_turn [A]\n0,0\n1,1\n")
    page.route("**/api/curves", answer)
    opened(page, bench, "recordings")
    page.get_by_label("train late.csv").check()
    page.locator("#plot").click()
    until(lambda: page.evaluate("1") and late, STEP_MS / 1e3)
    page.get_by_label("train late.csv").uncheck()
    page.get_by_label("train next.csv").check()
    page.locator("#plot").click()
    pane, box = page.locator("#recorded-panes .pane"), page.locator("#recorded-channels input")
    pane.wait_for()
    page.evaluate("document.querySelector('#recorded-panes .pane').id = 'of-next'")
    with page.expect_response("**/api/curves"):
        late[0]()
    page.select_option("#derive-how", "derivative")
    page.locator("#derive-add").click()
    page.locator("#errors", has_text="has 1 rows").wait_for()
    assert box.count() == 1, "what could not be derived is not chosen"
    assert page.locator("#of-next").count() == 1, "what came late was not drawn"
    box.uncheck()
    pane.wait_for(state="detached")
    box.check()
    pane.wait_for()


def test_the_drawing_turns_the_arm_as_its_machine_file_has_it(page: Page, bench: BenchPage) -> None:
    """Roll turns tube and detector about y through the isocentre, which the propeller turns about x: in SciPy's rotations."""
    let_in(page, bench)
    page.goto(f"{bench.address}/#state")
    bodies = [dataclasses.asdict(body) for body in facts_of("carm", load_machine("carm"), "lockstep:").bodies]
    propeller, roll = 0.4, -0.7
    found = page.evaluate(
        "async ([bodies, positions]) => (await import('/static/drawing.js')).places(bodies, positions)",
        [bodies, {"propeller": propeller, "roll": roll}],
    )
    at = {body["name"]: place["at"] for body, place in zip(bodies, found, strict=True)}
    turned = Rotation.from_euler("XY", [propeller, roll])
    for body, height_m in (("tube", -0.81), ("detector", 0.35)):
        assert at[body] == pytest.approx(turned.apply([0.0, 0.0, height_m]), abs=1e-12)
    assert at["support_arm"] == pytest.approx([-1.2, 0.0, 1.0], abs=1e-12)


def test_what_is_not_known_leaves_a_gap_and_its_pane_a_scale(page: Page, bench: BenchPage) -> None:
    let_in(page, bench)
    page.goto(f"{bench.address}/#state")
    column = "async (values) => (await import('/static/ring.js')).drawable(Float64Array.from(values, (value) => value ?? NaN))"
    drawn = page.evaluate(f"async (values) => Array.from(await ({column})(values))", [1.0, None, 2.0])
    assert drawn == [1.0, None, 2.0]


def test_a_speed_by_rows_is_that_of_the_newest_ones(page: Page, bench: BenchPage) -> None:
    let_in(page, bench)
    page.goto(f"{bench.address}/#state")
    found = page.evaluate(
        """async () => {
            const { Ring } = await import("/static/ring.js");
            const ring = new Ring([["time", "s"], ["position_turn", "rad"]], 100);
            const [none, rows] = [ring.rate("position_turn", 0.05), []];
            for (let k = 0; k < 3000; k += 1) rows.push(0.01 * k, k < 2900 ? 0 : 0.003 * (k - 2900));
            ring.put(Float64Array.from(rows));
            return [none, ring.rate("position_turn", 0.05), ring.rate("position_of_another", 0.05)];
        }"""
    )
    assert found[1] == pytest.approx(0.3)
    assert math.isnan(found[0])
    assert math.isnan(found[2])


def test_a_reload_and_a_second_browser_do_no_harm_and_closing_stops(browser: Browser, bench: BenchPage, console_errors: list[str]) -> None:
    page = browser.new_page()
    listen(page, console_errors)
    opened(page, bench, "experiments")
    fill_and_run(page, "static", seconds=36000)
    page.locator("#now", has_text="recording static").wait_for(timeout=STEP_MS)
    page.reload()
    second = browser.new_page()
    listen(second, console_errors)
    opened(second, bench, "scope")
    second.locator("#scope-note", has_text="rows").wait_for()
    second.locator("#now", has_text="another browser started it").wait_for()
    second.close()
    rows = page.locator("#now", has_text="this page keeps it running").inner_text()
    page.wait_for_timeout(2500)  # longer than a browser may be silent
    assert page.locator("#now.running").inner_text() != rows
    watcher = Watcher(bench)
    page.close()
    work = watcher.work(lambda work: work["state"] != "running", 30.0)
    watcher.close()
    assert work["state"] == "stopped"
    assert "answered no ping" in work["why"]


def test_commissioning_begins_with_clicks_alone(page: Page, bench: BenchPage) -> None:
    opened(page, bench, "commission")
    for step in ("check", "scan", "home", "static"):
        card = page.locator(f"[data-step={step}]")
        if card.get_attribute("open") is None:
            card.locator("summary").first.click()
        card.locator("button.start:enabled").click(timeout=STEP_MS)
        page.locator(f"[data-step={step}].passed").wait_for(timeout=STEP_MS)
        assert card.locator(".why").inner_text()
        assert "$ isocenter" in card.locator("pre").last.text_content() or step == "scan"
    assert json.loads((bench.folder / "still.json").read_text())["recordings"][0]["timing"]["ticks"] == 2000
    page.goto(f"{bench.address}/#recordings")
    page.get_by_role("link", name="still.mf4").wait_for()


def test_a_step_that_builds_on_another_says_so(page: Page, bench: BenchPage) -> None:
    opened(page, bench, "commission")
    card = page.locator("[data-step=observe]")
    card.locator("summary").first.click()
    card.locator("button.start:enabled").click(timeout=STEP_MS)
    card.locator(".refused", has_text="first identify").wait_for()


@pytest.mark.nightly
def test_a_diagnosis_from_the_page_is_read_in_its_bar(page: Page, bench: BenchPage) -> None:
    """Two recordings, and one that moves otherwise held out; the bar has the verdict's own sentence, and links the report."""
    opened(page, bench, "experiments")
    names = []
    for amplitude_deg, period_s in ((3.4, 10.0), (3.4, 10.0), (2.6, 8.0)):
        page.reload()
        fill_and_run(page, "jog", jog=amplitude_deg, period=period_s, periods=1)
        page.locator("#now.running").wait_for(timeout=STEP_MS)
        found = re.search(r"jog-\d+-\d+", ended(page, "passed"))
        assert found
        names.append(f"{found[0]}.mf4")
    page.goto(f"{bench.address}/#recordings")
    for kind, name in zip(("train", "train", "held"), names, strict=True):
        page.get_by_label(f"{kind} {name}").check()
    assert "2 chosen, 1 held out" in page.locator("#chosen").inner_text()
    page.locator("#diagnose").click()
    page.locator("#now.passed, #now.bad").filter(has_text="Diagnose").wait_for(timeout=4 * STEP_MS)
    answer = json.loads((bench.folder / "diagnosis.json").read_text())
    said = " ".join(page.locator("#now").inner_text().split())
    assert f"{answer['verdict'].replace('_', ' ')}: {answer['reason']}" in said
    assert page.get_by_role("link", name="open diagnosis/report.html").is_visible()


@pytest.mark.nightly
def test_the_emulated_arm_is_commissioned_from_the_first_click_to_the_observer(browser: Browser, tmp_path: Path) -> None:
    with bench_page(tmp_path, "carm", "lockstep:") as bench:
        pictures = ROOT / "build" / "screenshots"
        pictures.mkdir(parents=True, exist_ok=True)
        errors: list[str] = []
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        listen(page, errors)
        opened(page, bench, "commission")
        moved = []
        for step in ("check", "scan", "home", "static", "identify", "shape", "observe"):
            due = page.locator("button.main:enabled")  # strict: there is one
            due.wait_for(timeout=STEP_MS)
            moved.append("moves" in due.inner_text())
            due.click()
            page.locator(f"[data-step={step}].passed").wait_for(timeout=4 * STEP_MS)
            page.locator(f"[data-step={step}]:not([open])").wait_for()
        page.locator("#steps-done").wait_for()
        assert page.locator(".main:visible").all_inner_texts() == ["Next: an experiment"]
        assert moved == [False, False, True, True, True, False, True]
        assert (bench.folder / "machine.observer.npz").is_file()
        for name, width in WIDTHS.items():
            page.set_viewport_size({"width": width, "height": 900})
            for view in VIEWS:
                page.goto(f"{bench.address}/#{view}")
                page.wait_for_timeout(700)
                page.screenshot(path=pictures / f"bench-{view}-{name}.png", full_page=True)
        assert errors == []


@pytest.mark.nightly
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory is read from /proc")
def test_ten_minutes_of_scope_take_no_more_memory_than_three(page: Page, bench: BenchPage) -> None:
    opened(page, bench, "experiments")
    used = []
    for seconds in (200, 600):
        page.reload()
        opened(page, bench, "experiments")
        fill_and_run(page, "static", seconds=seconds)
        page.goto(f"{bench.address}/#scope")
        page.locator("#now", has_text="recording static").wait_for(timeout=STEP_MS)
        ended(page, "passed")
        page.locator("#scope-note", has_text=f"{200 * seconds} rows").wait_for()
        heap = page.evaluate("() => performance.memory.usedJSHeapSize")
        used.append((bench.server_bytes, heap))
    (server, heap), (server_later, heap_later) = used
    assert server_later < server + 20e6, used
    assert heap_later < heap + 30e6, used

"""A page is one file: the answer first, everything in it, no text taken for markup, numbers as they were given."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from hil.pages import Band, Bullets, Chart, Charts, Mark, Page, Picture, Scale, Section, Series, Table, Text, Verdict, html_of

TIME_s = np.arange(5000) / 250.0
WAVE = np.sin(TIME_s)
CHART = Chart("Wave", Scale("time [s]"), Scale("wave [m]"), [Series("recorded", TIME_s, WAVE), Series("simulated", TIME_s, 0.5 * WAVE)])
PAGE = Page(
    "Trial",
    Verdict("The roll axis rubs.", "bad"),
    [Section("Channels", [Charts([CHART])]), Section("More", [Text("Unfolded only by who asks.")], is_folded=True)],
    next_command="isocenter diagnose carm run.mf4 -o out",
    facts={"Machine": "carm"},
)


class Seen(HTMLParser):
    """Tags, attributes and text of a page, scripts and styles apart."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.scripts: list[str] = []
        self._in = ""
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self._in = tag
        if tag == "script":
            self.scripts.append("")

    def handle_endtag(self, tag: str) -> None:
        self._in = ""

    def handle_data(self, data: str) -> None:
        if self._in == "script":
            self.scripts[-1] += data
        elif self._in != "style":
            self.text += data


def packed(page: str) -> dict[str, list[dict[str, object]]]:
    """What the script of a page reads."""
    found = json.loads(Seen(page).scripts[0])
    assert isinstance(found, dict)
    return found


def decoded(array: dict[str, object]) -> np.ndarray:
    """An array as a browser decodes it."""
    if "f8" in array:
        return np.frombuffer(base64.b64decode(str(array["f8"])), dtype="<f8")
    if "f4" in array:
        return np.frombuffer(base64.b64decode(str(array["f4"])), dtype="<f4").astype(float) + float(str(array["middle"]))
    return float(str(array["first"])) + float(str(array["step"])) * np.arange(int(str(array["count"])))


def test_the_verdict_stands_before_all_else_and_the_next_command_after_it() -> None:
    text = " ".join(Seen(html_of(PAGE, "today")).text.split())
    order = [text.index(part) for part in ("The roll axis rubs.", "isocenter diagnose carm run.mf4 -o out", "Machine", "today", "Channels")]
    assert order == sorted(order)


def test_a_verdict_is_told_by_more_than_colour() -> None:
    signs = {kind: Seen(html_of(replace(PAGE, verdict=Verdict("So.", kind)))).text.split("So.")[0][-4:].strip() for kind in
             ("good", "bad", "unsure")}  # fmt: skip
    assert len(set(signs.values())) == 3
    assert all(signs.values())


def test_a_page_loads_nothing_from_anywhere() -> None:
    seen = Seen(html_of(replace(PAGE, sections=[*PAGE.sections, Section("Still", [Picture(b"png", "a picture")])])))
    outside = [value for _, attrs in seen.tags for name, value in attrs.items() if name in ("src", "href", "data", "action")]
    assert [value for value in outside if not str(value).startswith("data:")] == []
    policy = next(attrs["content"] for tag, attrs in seen.tags if attrs.get("http-equiv") == "Content-Security-Policy")
    assert "default-src 'none'" in str(policy)


def test_text_is_never_taken_for_markup() -> None:
    bad = "</script><script>alert(1)</script><b>'\"&"
    chart = Chart(bad, Scale(bad), Scale(bad), [Series(bad, TIME_s, WAVE)], marks=[Mark(1.0, bad)], pose=bad, note=bad)
    blocks = [Charts([chart]), Table((bad,), ((bad,),), caption=bad), Bullets((bad,), bad), Text(bad, bad), Picture(b"", bad, bad)]
    plain, seen = Seen(html_of(PAGE)), Seen(html_of(Page(bad, Verdict(bad), [Section(bad, blocks)], bad, bad, {bad: bad})))
    assert len(seen.scripts) == len(plain.scripts)
    assert "b" not in [tag for tag, attrs in seen.tags if "class" not in attrs and tag == "b"][1:]  # one of the page's own: "Next:"
    assert seen.text.count(bad) >= 14


def test_numbers_come_out_as_they_went_in() -> None:
    jittered = TIME_s + 1e-4 * np.sin(1e3 * TIME_s)
    high = 1e6 + 1e-3 * WAVE
    holed = np.where(TIME_s < 1.0, np.nan, WAVE)
    chart = Chart("c", Scale("t"), Scale("y"), [Series("a", jittered, high), Series("b", TIME_s, holed)])
    found = packed(html_of(Page("p", Verdict("v"), [Section("s", [Charts([chart])])])))
    first, second = found["charts"][0]["series"]  # type: ignore[misc]
    assert np.array_equal(decoded(found["arrays"][first["x"]]), jittered)
    assert np.allclose(decoded(found["arrays"][second["x"]]), TIME_s, rtol=0.0, atol=1e-9)
    assert np.abs(decoded(found["arrays"][first["y"]]) - high).max() < 1e-9
    assert np.allclose(decoded(found["arrays"][second["y"]]), holed, rtol=0.0, atol=1e-7, equal_nan=True)


def test_an_array_that_several_charts_share_is_in_the_page_once() -> None:
    one = html_of(replace(PAGE, sections=[Section("s", [Charts([CHART])])]))
    ten = html_of(replace(PAGE, sections=[Section("s", [Charts([CHART] * 10)])]))
    assert len(packed(ten)["arrays"]) == len(packed(one)["arrays"]) == 3
    assert len(ten) - len(one) < 9 * 4000


def test_a_page_without_charts_has_no_script() -> None:
    page = html_of(replace(PAGE, sections=PAGE.sections[1:]))
    assert Seen(page).scripts == []
    assert len(page) < 15_000


def test_what_was_emulated_says_so_before_the_title() -> None:
    assert "EMULATED" not in Seen(html_of(PAGE)).text
    text = Seen(html_of(replace(PAGE, is_emulated=True))).text
    assert text.index("EMULATED") < text.index("The roll axis rubs.")


def test_curves_differ_in_grey() -> None:
    series = [Series(str(k), TIME_s, k * WAVE) for k in range(6)] + [Series(f"p{k}", TIME_s, WAVE, is_points=True) for k in range(6)]
    styles = Chart("c", Scale("t"), Scale("y"), series).styles()
    assert len({style.dash for style in styles[:6]}) == 6
    assert len({style.marker for style in styles[6:]}) == 6


def test_what_cannot_be_drawn_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match="speed"):
        Series("speed", TIME_s, WAVE[1:])
    with pytest.raises(ValueError, match="decreases"):
        Series("speed", TIME_s[::-1], WAVE)
    with pytest.raises(ValueError, match="noise"):
        Band("noise", TIME_s, WAVE[:-1], WAVE)
    with pytest.raises(ValueError, match="a row of 1 cells"):
        Table(("a", "b"), (("1",),))


def test_points_may_come_in_any_order() -> None:
    series = Series("p", np.array([3.0, 1.0, 2.0]), np.array([30.0, 10.0, 20.0]), is_points=True)
    assert series.x.tolist() == [1.0, 2.0, 3.0]
    assert series.y.tolist() == [10.0, 20.0, 30.0]


def test_every_chart_has_title_units_pose_and_legend() -> None:
    chart = replace(CHART, pose="roll 30°", marks=[Mark(8.3, "8.3 Hz, damping 0.02")], note="Of the last period.")
    text = Seen(html_of(replace(PAGE, sections=[Section("s", [Charts([chart])])]))).text
    for said in ("Wave", "wave [m]", "roll 30°", "recorded", "simulated", "8.3 Hz, damping 0.02", "Of the last period."):
        assert said in text
    assert re.search(r'"labels": \["time \[s\]", "wave \[m\]"\]', html_of(replace(PAGE, sections=[Section("s", [Charts([chart])])])))

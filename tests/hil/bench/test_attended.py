"""A machine that is attended to: it moves while orders are renewed, and rests soon after the last; before homing it does not move."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bench_machines import carm_text_in
from bench_page import until

from hil.bench import attended, telling
from hil.bench.attended import Attended, Shown
from hil.bench.bench import Bench
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.bench.telling import Teller
from hil.bench.told_state import HOLDING, HOMING, LETTING_GO, ON_THE_WAY, READY, RECORDING, SETTLING, STOPPING, TAKING_HOLD, WATCHING
from hil.experiments import Move, Static
from hil.machine import load_machine, machine_from_text

MACHINE = load_machine("turntable")
RATE_Hz = MACHINE.sample_rate_Hz
SPEED = 0.1
HELD_ROWS = round(1.4 * RATE_Hz)
FEW_TICKS = 12
ENABLED = 0x37
TOLD_S = 10.0


class Hand:
    """Homes, holds a button for a while, leaves it, and ends once the reference stands; notes every row of the jog."""

    def __init__(self, bench: Bench, shown: Shown, still: bool) -> None:
        self.shown, self.put = shown, shown.put
        self.column = [name for name, _ in bench.loop.layout.channels].index("reference_turn")
        self.still, self.rows = still, list[float]()
        shown.put = self.see

    def see(self, row: np.ndarray) -> None:
        self.put(row)
        if self.shown.doing == HOLDING:
            self.rows.append(float(row[self.column]))

    def orders(self) -> list[str]:
        if self.shown.doing == WATCHING:
            return ["home"]
        if len(self.rows) < HELD_ROWS:
            return [f"jog turn {SPEED}"]
        if len(self.rows) == HELD_ROWS and self.still:
            return ["still"]
        return ["end"] if len(set(self.rows[-FEW_TICKS:])) == 1 else []


def jogged(still: bool) -> np.ndarray:
    with open_bench(MACHINE, BenchOptions("lockstep:")) as bench:
        hand = Hand(bench, Teller(bench, rows=True).shown, still)
        Attended(bench, hand.orders, hand.shown).serve()
        assert bench.pose[0] == pytest.approx(hand.rows[-1], abs=np.radians(0.5))  # its brake closes before the feedback has settled
    return np.array(hand.rows)


def test_it_moves_at_the_ordered_speed_and_rests_as_soon_as_its_jerk_allows_when_it_is_let_go() -> None:
    """A speed v is left with a jerk j in 2 sqrt(v / j), where the acceleration's limit is not reached."""
    rows = jogged(still=True)
    limit = MACHINE.limits[0]
    assert np.diff(rows[HELD_ROWS - 20 : HELD_ROWS]) * RATE_Hz == pytest.approx(SPEED, rel=1e-6)
    moves = np.flatnonzero(np.diff(rows))
    least_s = max(2.0 * np.sqrt(SPEED / limit.jerk), SPEED / limit.acceleration + limit.acceleration / limit.jerk)
    assert moves[-1] - HELD_ROWS <= round(least_s * RATE_Hz) + FEW_TICKS


def test_it_rests_when_nobody_renews_the_order() -> None:
    rows = jogged(still=False)
    assert len(rows) > HELD_ROWS
    assert rows[-1] > rows[HELD_ROWS - 1]


def test_an_order_to_home_that_came_during_a_jog_is_not_followed_when_that_is_over(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(attended, "HOLD_S", 0.5)
    with open_bench(MACHINE, BenchOptions("lockstep:")) as bench:
        shown, seen, waiting = Teller(bench, rows=False).shown, list[str](), ["home", f"jog turn {SPEED}"]

        def take() -> list[str]:
            seen.append(shown.doing)
            if shown.doing == HOLDING:
                return ["home"]
            if waiting and shown.doing in (WATCHING, READY):
                return [waiting.pop(0)]
            return ["end"] if HOLDING in seen and seen[-FEW_TICKS:].count(READY) == FEW_TICKS else []

        homed: list[str] = []
        monkeypatch.setattr(bench, "home", lambda: homed.append(shown.doing) or Bench.home(bench))
        Attended(bench, take, shown).serve()
    assert HOLDING in seen
    assert homed == [HOMING]


def refused(bench: Bench, *orders: str) -> str:
    """What is said when a machine that is ready or not is ordered to move, and is then left."""
    shown = Teller(bench, rows=False).shown
    waiting, said = list(orders), []

    def take() -> list[str]:
        said.append(shown.says)
        assert shown.doing != HOLDING
        return [waiting.pop(0)] if waiting and shown.doing in (WATCHING, READY) else [] if not said[-1] else ["end"]

    Attended(bench, take, shown).serve()
    return said[-1]


def test_before_homing_nothing_moves() -> None:
    with open_bench(MACHINE, BenchOptions("lockstep:")) as bench:
        assert "home first" in refused(bench, "jog turn 0.1")


def test_drives_that_go_to_poses_by_themselves_are_not_led() -> None:
    with open_bench(machine_from_text(carm_text_in("profile_position")), BenchOptions("lockstep:")) as bench:
        assert "profile position mode" in refused(bench, "home", "jog roll 0.1")


def test_a_run_tells_its_phases_and_what_remains_of_the_way(tmp_path: Path) -> None:
    """The way is told with all its ticks, one second of bridge among them; the loop has its computer to itself while it records."""
    (plan,) = Static(1.0, {"turn": 0.3}).plans(MACHINE)
    told: list[tuple[str, str, int]] = []
    ends: dict[str, float | None] = {}
    with open_bench(MACHINE, BenchOptions("lockstep:"), np.array([0.0])) as bench:
        teller = Teller(bench, rows=False)
        begin = bench.tell

        def heard(doing: str, part: str, ticks: int) -> None:
            begin(doing, part, ticks)
            told.append((doing, part, ticks))
            ends[doing] = teller.state()["axes"]["turn"]["goes_to"]

        bench.tell = heard
        began = bench.wiring.link.syncs
        bench.run(plan, tmp_path / "still.mf4")
        assert bench.wiring.link.syncs > began
    assert [doing for doing, _, _ in told] == [HOMING, TAKING_HOLD, ON_THE_WAY, SETTLING, RECORDING, LETTING_GO]
    ticks = {doing: count for doing, _, count in told}
    (way,) = Move({"turn": 0.0}, {"turn": 0.3}).plans(MACHINE)
    assert ticks[ON_THE_WAY] == pytest.approx(way.rows + RATE_Hz, abs=2)
    assert ticks[RECORDING] == plan.rows
    assert told[0][1] == "turn, 1 of 1"
    assert told[4][1] == "still.mf4"
    assert ends == {doing: pytest.approx(0.3) if doing in (ON_THE_WAY, SETTLING) else None for doing in ticks}


def test_what_remains_falls_as_the_machine_ticks() -> None:
    with open_bench(MACHINE, BenchOptions("lockstep:")) as bench:
        teller = Teller(bench, rows=False)
        with bench.session(homes=False):
            bench.tell(ON_THE_WAY, "", round(RATE_Hz))
            before = teller.state()
            for _ in range(round(0.25 * RATE_Hz)):
                bench.wiring.link.exchange(bench.wiring.link.zeros)
            after = teller.state()
        assert (before["doing"], before["remains_s"]) == (ON_THE_WAY, pytest.approx(1.0))
        assert after["remains_s"] == pytest.approx(0.75)
        bench.tell(HOMING, "turn, 1 of 1", 0)
        assert (teller.state()["part"], teller.state()["remains_s"]) == ("turn, 1 of 1", None)


@pytest.mark.parametrize("doing", [WATCHING, READY])
def test_rest_is_told_only_while_no_stop_runs_and_no_drive_has_voltage(doing: str) -> None:
    with open_bench(MACHINE, BenchOptions("lockstep:")) as bench:
        teller, link = Teller(bench, rows=False), bench.wiring.link
        with bench.session(homes=False):
            teller.shown.doing = doing
            assert teller.state()["doing"] == doing
            link.stopping = True
            assert (teller.state()["doing"], teller.state()["homed"]) == (STOPPING, doing == READY)
            link.stopping = False
            link.inputs[0].statusword = ENABLED
            assert teller.state()["doing"] == STOPPING


def test_a_stop_is_told_while_a_run_records(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(telling, "EVERY_S", 0.01)
    said = ""

    def told(doing: str) -> bool:
        nonlocal said
        said += capsys.readouterr().out
        return f'"doing": "{doing}"' in said

    with open_bench(MACHINE, BenchOptions("lockstep:")) as bench, Teller(bench, rows=False):
        bench.tell(RECORDING, "still.mf4", 100)
        until(lambda: told(RECORDING), TOLD_S)
        bench.wiring.link.stopping = True
        until(lambda: told(STOPPING), TOLD_S)
        bench.wiring.link.stopping = False

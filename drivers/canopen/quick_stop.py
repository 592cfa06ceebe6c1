"""The stop of one axis: quick stop and brake at once, standstill, proof of the brake, voltage off. One step per tick.

An axis with gravity on it is held by its drive or by its brake. So the drive keeps its voltage until the brake is proven: its feedback says
closed, and the link stays where it is while the drive lets go and pushes a little. Where that fails, the drive goes on holding, for as long
as that is a hold (`drivers.canopen.hold`): a drive that pushes loses its voltage, whatever the brake says.

The brake does not wait for the standstill: it shortens the travel, and it is all there is where the drive does not obey.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from math import isfinite, nan

from drivers.canopen import cia402
from drivers.canopen.axis_rest import NOT_PROVEN, POWERED, AxisRest
from drivers.canopen.brake_proof import BrakePush
from drivers.canopen.cia402 import State
from drivers.canopen.encoder_path import EncoderPath, slipped
from drivers.canopen.hold import ANSWER_S, Carried, Hold
from drivers.canopen.network import NMT_RESET_NODE, NMT_STOP
from drivers.canopen.standstill import Standstill
from drivers.interface import Sample
from drivers.settings import AxisScaling, HomingSettings, MotionLimits

CLOSING_S = 1.0  # Modbus poll, relay, armature, feedback, Modbus poll
SETTLING_S = 5.0  # a drive's own velocity loop creeps for seconds before its counter stands
STANDSTILL_S = 0.05  # a motor whose position has not changed for this long stands still
STANDSTILL_COUNTS = 1.5  # a position held by its drive may flicker by a count
SWING_S = 0.25  # of the link before its brake is proven: a whole period at 4 Hz, slower than any mode of such a structure
STANDING_SHARE = 0.1
"""Of the tracking error: range in which a link may swing that stands, and in which a drive that holds it may shake it. On the C-arm, 5.2
mrad: its slowest gear (8 Hz, damping 0.8 %) swings by 4.2 mrad after a quick stop of 10.7 rad/s^2 (a / omega^2), 2.6 mrad after 1.2 s."""
WATCH_S = 0.1  # after voltage off; a heavy arm falls ten times the travel that is noticed
REST_WATCH_S = 1.0  # after a stop without a push: a load that exceeds the brake by a thousandth shows itself by then
VOLTAGE_OFF_S = 0.2  # a drive that still has its voltage after this does not obey
RETAKE_S = 0.5  # three transitions of CiA 402, each with its answer, and lost frames
STOP_AT_MOST_S = 10.0  # of all steps together: a feedback that flickers must not keep a stop from ending


class AxisStop:
    """The stop of one axis.

    Parameters
    ----------
    axis : int
        Of the arrays of a sample.
    scaling : AxisScaling
    limits : MotionLimits
    homing : HomingSettings
        Its first-move check says which push moves the axis with an open brake, and how far a moved axis moves.
    period_s : float
        Between ticks.
    braked : bool
        Whether the I/O commands a brake of this axis and reports it.
    takes_torque : bool
        Whether the drive is in cyclic synchronous torque mode; otherwise it must be brought there to push against the brake.
    pushes : bool
        Whether the drive takes an effort at all; one that does not lets go of its brake without a push, watched.

    Attributes
    ----------
    controlword : int
    effort : float
        Both for the next tick, in the drive's unit.
    orders_brake : bool
        Whether the brake is to be told to close; whoever tells it clears this.
    orders_node : int
        NMT command that its drive is to be sent, 0: none; cleared likewise. The communication of one that answers no SYNC is stopped, on
        which it stops by itself (6007h). One that keeps its voltage against its order is reset, on which it loses it.
    alarm : str
        What an operator must be told at once; cleared likewise.
    asks_for_torque : bool
        Whether the drive must be brought into cyclic synchronous torque mode for the proof; answered by `torque_mode`.
    """

    def __init__(
        self,
        axis: int,
        scaling: AxisScaling,
        limits: MotionLimits,
        homing: HomingSettings,
        period_s: float,
        *,
        braked: bool,
        takes_torque: bool,
        pushes: bool = True,
    ) -> None:
        self.axis, self.name = axis, scaling.axis
        self.controlword = cia402.QUICK_STOP
        self.effort = 0.0
        self.orders_brake = self.asks_for_torque = False
        self.orders_node, self.alarm = 0, ""
        self._unit, self._rated, self._period_s = scaling.position_unit, scaling.rated, period_s
        self._braked, self._takes_torque, self._pushes = braked, takes_torque, pushes
        self._flicker = STANDSTILL_COUNTS * scaling.position_resolution
        self._apart = STANDING_SHARE * limits.tracking_error
        self._stale_ticks = limits.stale_ticks
        self._push, self._travel = homing.direction_check_effort, homing.direction_check_travel
        self._standstill = Standstill(self._flicker, self._apart, self._travel, period_s)
        self._motor, self._link = EncoderPath(self._in_ticks(SWING_S)), EncoderPath(self._in_ticks(SWING_S))
        self._hold_judge = Hold(limits, scaling.position_unit, period_s, scaling.rated)
        self._marked: EncoderPath | None = None  # by which the proof of the brake is judged
        self._held_effort = nan
        self._carried = Carried(self._push, scaling.rated)
        self._brake_push = BrakePush(self._push, 0.0, scaling.rated)
        self._silent = self._lost = 0  # ticks without a statusword, without any position
        self._state = State.UNDEFINED
        self._closed: bool | None = None  # what the brake's feedback says; None: nobody knows
        self._proof = self._held_for = self._held_because = self._drove = ""
        self._rested_ticks, self._watch_s = 0, WATCH_S  # without voltage, and how long it is watched then
        self._retries, self._watched, self._let_go_again = False, True, braked and not pushes
        self._rest: AxisRest | None = None
        self._ticks = self._all_ticks = 0
        self._steps: list[tuple[str, float]] = []
        self._phase: Callable[[], None] = self._closing
        self._close()

    # ---- from outside ----------------------------------------------------------------------------------
    @property
    def rest(self) -> AxisRest | None:
        """How the stop ended; None while it is under way."""
        if self._held_for:
            stands = self._stands()
            seen = "held by its drive" if stands else f"{NOT_PROVEN}: its drive is told to hold it and {self._motion_words}"
            return self._as_rest(False, f"{seen}: {self._held_for}{self._carried.lost(self._held_effort)}", may_move=not stands, held=True)
        return self._rest

    def prove(self, effort: float) -> None:
        """Begin where a motion has ended by itself: its drive enabled with this effort, its brake closed.

        An axis whose brake is not the bench's is stopped as from any other state. Where the drive's own loops add to the effort, what it
        measures is taken for what holds.
        """
        if not self._braked:
            return
        self.controlword, self.effort = cia402.ENABLE_OPERATION, effort
        self._held_effort = effort if self._takes_torque else nan
        self.orders_brake = False
        self._go(self._swinging)

    def close_again(self) -> None:
        """Tell the brake of a held axis to close once more; a brake that slipped is not tried again."""
        if self._held_for and self._retries:
            self._close()

    def torque_mode(self, reached: bool) -> None:
        """Answer `asks_for_torque`."""
        self.asks_for_torque, self._takes_torque = False, reached
        if not reached:
            self._hold("its drive does not change to torque mode, so nothing can push against its brake")

    def release(self) -> None:
        """Take the voltage from a held axis that stands: an operator has confirmed that it is supported."""
        if self._held_for and self._stands():
            self._held_for, self._watched = "", False
            self._let_go("released by the operator")

    def step(self, sample: Sample, *, io_is_fresh: bool, ticks: int = 1) -> None:
        """Take a sample, `ticks` after the one before; set controlword, effort and brake for the next."""
        self._see(sample, io_is_fresh, ticks)
        self._judge_hold(sample, ticks)
        seen = self._motor.fresh(self._stale_ticks), self._link.fresh(self._stale_ticks)
        at = float(sample.position[self.axis]), float(sample.link_position[self.axis])
        self._standstill.note(*at, seen, stands=self._stands())
        self._ticks += 1
        if self.rest is None:
            self._all_ticks += 1
            if self._flickers() and self._phase not in (self._closing, self._taking_voltage):
                self._close()
        self._phase()

    # ---- what is seen ----------------------------------------------------------------------------------
    def _see(self, sample: Sample, io_is_fresh: bool, ticks: int) -> None:
        axis = self.axis
        statusword = int(sample.statusword[axis])
        self._silent = 0 if statusword >= 0 else self._silent + 1
        if statusword >= 0:
            self._state = cia402.decode_state(statusword)
        elif self._silent > self._stale_ticks:
            self._state = State.UNDEFINED
        position, link, effort = float(sample.position[axis]), float(sample.link_position[axis]), float(sample.effort[axis])
        self._motor.take(position)
        self._link.take(link)
        self._lost = 0 if isfinite(position) or isfinite(link) else self._lost + 1
        self._standstill.take(position, link, ticks)
        by_itself = self._state is State.QUICK_STOP_ACTIVE or (self._phase == self._swinging and not self._takes_torque)
        if isfinite(effort) and by_itself:
            before = self._held_effort if isfinite(self._held_effort) else effort
            self._held_effort = before + (effort - before) / self._in_ticks(STANDSTILL_S)
        if self._phase == self._pushing:
            self._brake_push.take(self._ticks * self._period_s, effort)
        self._closed = (not bool(sample.brakes_open[axis]) if io_is_fresh else None) if self._braked else None

    def _judge_hold(self, sample: Sample, ticks: int) -> None:
        """Take the voltage from a drive that may push while it is told to hold."""
        axis = self.axis
        motor, link, effort = float(sample.position[axis]), float(sample.link_position[axis]), float(sample.effort[axis])
        holds = self._phase in (self._closing, self._swinging, self._taking_over, self._pushing, self._holding)
        if not holds or not (self._state in POWERED or self._state is State.UNDEFINED):
            self._hold_judge.begin()
        elif drove := self._hold_judge.step(motor, link, effort, ticks):
            self._drove, self._held_for = drove, ""
            self.alarm = f"its drive does not hold it, {drove}; its voltage is taken"
            self.orders_brake, self.asks_for_torque = True, False
            self._go(self._taking_voltage)

    def _in_ticks(self, seconds: float) -> int:
        return math.ceil(seconds / self._period_s)

    def _after(self, seconds: float) -> bool:
        return self._ticks >= self._in_ticks(seconds)

    def _flickers(self) -> bool:
        """Return whether the steps have begun anew for too long."""
        return self._all_ticks > self._in_ticks(STOP_AT_MOST_S)

    @property
    def _judge(self) -> EncoderPath:
        """The link's path, which carries the load, where it is seen; else the motor side's."""
        return self._link if self._link.fresh(self._stale_ticks) else self._motor

    def _stands(self) -> bool:
        """Return whether both encoders have stood still; a structure that swings on behind a standing motor stands."""
        if self._motor.fresh(self._stale_ticks) and self._standstill.motor.ticks < self._in_ticks(STANDSTILL_S):
            return False
        return self._lost <= self._stale_ticks and self._judge.range <= self._apart

    def _slipped(self) -> str:
        """Return which side is outside its swing of before, and how far, in words; '' where none is."""
        sides = {"its link": self._link, "its motor side": self._motor}
        moved = {name: path.beyond() for name, path in sides.items() if path.fresh(self._stale_ticks)}
        return slipped(moved, self._travel, self._apart, self._unit)

    @property
    def _brake_words(self) -> str:
        if not self._braked:
            return "the bench commands no brake of it"
        if self._closed is None:
            return "the I/O does not say whether its brake is closed"
        return "its brake reports closed" if self._closed else "its brake reports open"

    @property
    def _motion_words(self) -> str:
        if self._stands():
            return "it stands"
        if self._lost > self._stale_ticks:
            return "nobody knows whether it moves"
        both = self._motor.fresh(self._stale_ticks) and self._link.fresh(self._stale_ticks)
        stands_still = self._link.range <= self._flicker < self._motor.range
        if both and (stands_still or self._motor.range - self._link.range > self._apart):
            return "its motor side shows motion, its link none"
        return "IT MOVES"

    # ---- the sequence ----------------------------------------------------------------------------------
    def _go(self, phase: Callable[[], None]) -> None:
        if self._ticks:
            self._steps.append((self._phase.__name__.strip("_").replace("_", " "), self._ticks * self._period_s))
        self._phase, self._ticks = phase, 0

    def _close(self) -> None:
        """Order quick stop and brake."""
        self.orders_brake, self._held_for = True, ""
        self._go(self._closing)

    def _closing(self) -> None:
        """Wait for brake and standstill; the drive holds meanwhile, if it can."""
        self.controlword, self.effort = cia402.QUICK_STOP, 0.0
        if self._silent == self._in_ticks(ANSWER_S):
            self.orders_node = NMT_STOP
        if not self._flickers() and (self._closed or not self._braked) and self._stands():
            if self._state is State.QUICK_STOP_ACTIVE:
                self._go(self._swinging)
                return
            if self._state not in POWERED and self._state is not State.UNDEFINED:
                self.controlword = cia402.DISABLE_VOLTAGE
                self._go(self._watching)
                return
        settles = self._state is State.QUICK_STOP_ACTIVE and (self._closed or not self._braked)
        if not self._after(SETTLING_S if settles else CLOSING_S):
            return
        if self._state is State.QUICK_STOP_ACTIVE:
            told = [] if settles else [f"{self._brake_words} {CLOSING_S:g} s after it was told to close"]
            self._hold(", ".join([*told, "it stands" if self._stands() else "it had not come to stand"]))
            self._retries = True
            return
        self._give_up()

    def _give_up(self) -> None:
        """End without a drive that holds: the brake is all there is."""
        if self._state is State.UNDEFINED:
            drive = "its drive does not answer"
        elif self._state is State.OPERATION_ENABLED:
            drive = "its drive does not obey the quick stop and may push: take its supply away"
        else:
            when = "after" if self._state is State.FAULT_REACTION_ACTIVE else "in"
            drive = f"its drive reports {self._state.value}, {when} which it holds nothing"
        self._end(False, f"{NOT_PROVEN}: {drive}; {self._brake_words}; {self._motion_words}")

    def _swinging(self) -> None:
        """See how far the structure swings, then let go: all that it moves beyond that is the brake's slip."""
        if self._lost_hold() or not self._after(SWING_S) or self.asks_for_torque:
            return
        self._marked = self._judge
        for path in (self._motor, self._link):
            path.mark()
        if not self._braked:
            self._let_go("")
        elif not self._pushes:
            self._let_go_unpushed("its drive takes no effort")
        elif self._takes_torque:
            self._go(self._taking_over)
        else:
            self.asks_for_torque = True

    def _taking_over(self) -> None:
        """Turn the drive's own hold into a torque of the same size (transition 16)."""
        self.controlword = cia402.ENABLE_OPERATION
        self.effort = self._held_effort if isfinite(self._held_effort) else 0.0
        if self._lost_hold():
            return
        if self._state is State.OPERATION_ENABLED:
            self._brake_push = BrakePush(self._push, self.effort, self._rated)
            self._go(self._pushing)
        elif self._after(2.0 * ANSWER_S):  # the transition is optional in the standard
            self._let_go_unpushed("its drive does not leave quick stop for torque")

    def _pushing(self) -> None:
        """Let go, then push the way the load pulls: as hard as the first move was pushed, and a share of the load."""
        push, time_s = self._brake_push, self._ticks * self._period_s
        self.effort = push.effort(time_s)
        if self._lost_hold() or not push.is_over(time_s):
            return
        if push.not_given:
            self._let_go_unpushed(push.not_given)
        else:
            self._let_go("brake proven")

    def _let_go(self, proof: str, watch_s: float = WATCH_S) -> None:
        self._proof, self._watch_s = proof, watch_s
        self._go(self._letting_go)

    def _let_go_unpushed(self, reason: str) -> None:
        """Let go of a brake that nothing has pushed: a load that just exceeds it takes longer to show."""
        self._let_go(f"brake closed by its feedback, not pushed: {reason}", REST_WATCH_S)

    def _lost_hold(self) -> bool:
        """Leave the proof where it fails; return whether it has."""
        moved = self._slipped() if self._phase != self._swinging else ""
        if self._state not in (State.QUICK_STOP_ACTIVE, State.OPERATION_ENABLED):
            self._close()
        elif moved:
            self._hold(f"{moved} when the drive let go")
        elif self._braked and not self._closed:
            self._close()
        elif self._lost > self._stale_ticks or (self._phase != self._swinging and self._judge is not self._marked):
            self._hold("its position is not known, so its brake cannot be proven")
            self._retries = True
        else:
            return False
        return True

    def _letting_go(self) -> None:
        """Voltage off, watched, and taken back at once if the link moves."""
        self.controlword, self.effort = cia402.DISABLE_VOLTAGE, 0.0
        moved = self._slipped()
        if moved and self._watched:
            self._held_because = f"{moved} when the voltage went; {self._brake_words}"
            self._go(self._taking_back)
        elif self._state in POWERED:
            if self._after(VOLTAGE_OFF_S):
                self._end(False, f"{NOT_PROVEN}: its drive keeps its voltage ({self._state.value}); {self._brake_words}")
        elif self._after(self._watch_s):
            proof = self._proof or "it stands without a brake of the bench's"
            self._end(self._stands() or bool(self._closed), f"at rest: {proof}, voltage off")

    def _taking_back(self) -> None:
        """Enable the drive again, with no torque: what it held with may have been wound up against the brake.

        One that cannot be let go slowly has so released what it had wound up; a brake that slips moves the link a second time.
        """
        self.effort = 0.0
        if self._state in (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE):
            first, self._let_go_again = self._let_go_again, False
            if first:
                self._close()
            else:
                self._hold(self._held_because)
            return
        word = cia402.next_controlword(self._state, State.OPERATION_ENABLED)
        if word is None or self._after(RETAKE_S):
            self._give_up()
        else:
            self.controlword = word

    def _watching(self) -> None:
        """Without voltage from the start: the brake, or nothing, holds the axis; see that it stands."""
        self.controlword = cia402.DISABLE_VOLTAGE
        if not self._stands() or (self._braked and not self._closed):
            self._close()
        elif self._after(REST_WATCH_S if self._braked else WATCH_S):
            fault = f", its drive in {self._state.value}" if self._state is State.FAULT else ""
            brake = "brake closed by its feedback" if self._braked else "it stands without a brake of the bench's"
            self._end(True, f"at rest: {brake}, no voltage{fault}")

    def _taking_voltage(self) -> None:
        """Without voltage, see whether the brake holds the axis, for as long as a weak one takes to end the motion."""
        self.controlword, self.effort = cia402.DISABLE_VOLTAGE, 0.0
        drove = f"its drive did not hold it, {self._drove}"
        if self._state in POWERED or self._state is State.UNDEFINED:
            if self._ticks == self._in_ticks(ANSWER_S):
                self.orders_node = NMT_RESET_NODE
            if self._after(VOLTAGE_OFF_S):
                keeps = "does not answer" if self._state is State.UNDEFINED else f"keeps its voltage ({self._state.value})"
                self._end(False, f"{NOT_PROVEN}: {drove}, and {keeps}; {self._brake_words}; {self._motion_words}")
            return
        rests = self._stands() and (self._closed or not self._braked)
        self._rested_ticks = self._rested_ticks + 1 if rests else 0
        if self._rested_ticks > self._in_ticks(REST_WATCH_S):
            brake = "brake closed by its feedback, not pushed" if self._braked else "it stands without a brake of the bench's"
            self._end(True, f"at rest: {brake}: {drove}, voltage off")
        elif not rests and self._after(SETTLING_S if self._closed else CLOSING_S):
            self._end(False, f"{NOT_PROVEN}: {drove}, voltage off; {self._brake_words}; {self._motion_words}")

    def _hold(self, reason: str) -> None:
        self.controlword, self.effort = cia402.QUICK_STOP, 0.0
        self._held_for, self._retries = reason, False
        self._go(self._holding)

    def _holding(self) -> None:
        self.controlword = cia402.QUICK_STOP
        if self._state is not State.QUICK_STOP_ACTIVE and self._after(ANSWER_S):
            self._close()
        elif self._stands():
            self._carried.take(self._held_effort)

    def _end(self, safe: bool, words: str) -> None:
        self._go(self._ended)
        self._rest = self._as_rest(safe, words, may_move=not safe)
        if safe:
            self.controlword = cia402.DISABLE_VOLTAGE
        self.effort = 0.0

    def _as_rest(self, safe: bool, words: str, *, may_move: bool, held: bool = False) -> AxisRest:
        within = f"{max(self._apart, self._flicker):.1e} {self._unit}"
        return AxisRest(self.name, safe, held, words, tuple(self._steps), self._standstill.stood_s, may_move, within)

    def _ended(self) -> None:
        """Change nothing more."""

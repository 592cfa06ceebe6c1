"""CiA 402 servo drive: finite state automaton, cyclic synchronous torque, homing, stops and faults.

The machine calls `command` and `latch` once per sample: `command` returns the effort the motor feels from that instant on, then `latch`
takes the sensors' readings.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

from drivers.canopen.eds import load_object_dictionary
from virtual_bus.canopen import abort
from virtual_bus.canopen.abort import SdoAbortError
from virtual_bus.canopen.homing import SUPPORTED_METHODS, Homing, HomingState, Reference
from virtual_bus.canopen.motion import SpeedMeter, VelocityGains, VelocityLoop
from virtual_bus.canopen.node import Emit, Node
from virtual_bus.canopen.objects import Value, key_of
from virtual_bus.canopen.power_state import HALT, PowerState, next_state
from virtual_bus.settings import EmulatedDrive

NO_MODE, HOMING_MODE, TORQUE_MODE = 0, 6, 10
MODES = frozenset({NO_MODE, HOMING_MODE, TORQUE_MODE})
HOMING_START = 1 << 4
VOLTAGE_ENABLED, WARNING, REMOTE = 1 << 4, 1 << 7, 1 << 9
TARGET_REACHED, INTERNAL_LIMIT, HOMING_ATTAINED, HOMING_ERROR = 1 << 10, 1 << 11, 1 << 12, 1 << 13
FOLLOWS_COMMAND = 1 << 12  # in cyclic synchronous torque mode

OVERCURRENT, OVERTEMPERATURE, HEARTBEAT_LOST, CONNECTION_LOST = 0x2310, 0x4310, 0x8130, 0x8100  # EMCY codes
STOP_TIMEOUT_S = 5.0  # a motor that has not come to rest by then is switched off
STANDSTILL_SHARE = 0.5  # of the slowest homing speed; a slower motor counts as standing
_POWERED = (PowerState.SWITCHED_ON, PowerState.OPERATION_ENABLED, PowerState.QUICK_STOP_ACTIVE)
_MOVING = (PowerState.OPERATION_ENABLED, PowerState.QUICK_STOP_ACTIVE, PowerState.FAULT_REACTION_ACTIVE)
_INT16 = 32767


class Cia402Drive(Node):
    """One drive of the emulated machine.

    Parameters
    ----------
    settings : EmulatedDrive
    period_s : float
        Sample period: how often `command` and `latch` are called.
    emit : callable
        Takes (CAN identifier, data).
    memory : path, optional
        File of the stored parameters.
    """

    volatile = frozenset({0x603F, 0x6040, 0x6060, 0x6071})

    def __init__(self, settings: EmulatedDrive, period_s: float, emit: Emit, memory: Path | None = None) -> None:
        super().__init__(load_object_dictionary(settings.eds, settings.node_id), settings.node_id, emit, memory)
        self.settings = settings
        self._period_s = period_s
        self._effort_per_permille = settings.sign * settings.rated / 1000.0
        self._permille_per_effort = 1.0 / self._effort_per_permille
        self.factory_setting(0x6072, 0, int(1000.0 * settings.limit / settings.rated))
        self.factory_setting(0x6073, 0, int(1000.0 * settings.limit / settings.rated))
        self.factory_setting(0x6075, 0, settings.rated_current_mA)
        self.factory_setting(0x6076, 0, settings.rated_torque_mNm)
        entry = self.objects.find
        self._controlword, self._statusword, self._error_code = entry(0x6040), entry(0x6041), entry(0x603F)
        self._mode, self._mode_display = entry(0x6060), entry(0x6061)
        self._position, self._velocity = entry(0x6064), entry(0x606C)
        self._target, self._demand, self._torque, self._current = entry(0x6071), entry(0x6074), entry(0x6077), entry(0x6078)
        self._inputs, self._temperature = entry(0x60FD), entry(0x2000)
        self._max_torque, self._max_current = entry(0x6072), entry(0x6073)
        self._install_checks()
        negative, positive = self._counts(settings.negative_switch), self._counts(settings.positive_switch)
        reference = Reference(settings.counts_per_turn, negative, positive)
        per_count = settings.position_resolution * 1000.0 / settings.rated
        gains = VelocityGains(settings.velocity_gain * per_count, settings.velocity_integral_gain * per_count)
        self._speed = SpeedMeter(period_s)
        self._loop = VelocityLoop(gains, period_s, STANDSTILL_SHARE * self.objects.number(0x6099, 2))
        self.homing = Homing(reference)
        self._origin = self._absolute = self._offset = 0
        self.power_state = PowerState.NOT_READY_TO_SWITCH_ON
        self._causes: set[int] = set()  # of persistent faults: no reset while one is there
        self._clear()

    def _install_checks(self) -> None:
        def one_of(allowed: frozenset[int]) -> Callable[[Value], None]:
            def check(value: Value) -> None:
                if value not in allowed:
                    raise SdoAbortError(abort.INVALID_VALUE)

            return check

        self.objects.checks[key_of(0x6060)] = one_of(MODES)
        self.objects.checks[key_of(0x6098)] = one_of(SUPPORTED_METHODS)
        self.objects.effects[key_of(0x6040)] = lambda value: self._obey()
        self.objects.effects[key_of(0x6060)] = lambda value: self._choose_mode()

    def _counts(self, position: float | None) -> int | None:
        return None if position is None else round(position / self.settings.position_resolution) * self.settings.sign

    # ---- life -----------------------------------------------------------------------------------------
    def place(self, position: float) -> None:
        """Place the axis at this joint position [rad or m], with the drive's counter at zero.

        Index pulse and switches stand where they are; the counter does not know the position.
        """
        self._origin = self._absolute = self._counts(position) or 0
        self._offset = -self._absolute
        self._speed.restart()

    def application_reset(self) -> None:
        """Switch the power stage off, set the position counter to zero, and forget the home position."""
        self._offset = -self._absolute
        self.homing.reset()
        self._speed.restart()
        self._clear()
        self._set_state(PowerState.SWITCH_ON_DISABLED)  # transitions 0 and 1

    def _clear(self) -> None:
        self._settled: tuple[int, PowerState] | None = None  # controlword and state from which no transition follows
        self._last_controlword = 0
        self._after_stop: PowerState | None = None
        self._stopping = self._halted = self._limited = self._warm = False
        self._deceleration = math.inf
        self._stop_began_s = 0.0
        self._permille = 0
        self._last_temperature_degC = math.nan
        self._faults: list[int] = []

    # ---- faults ---------------------------------------------------------------------------------------
    def inject_fault(self, code: int, *, persistent: bool = False) -> None:
        """Raise a fault of the power stage.

        While a persistent cause remains, the fault cannot be reset.
        """
        if persistent:
            self._causes.add(code)
        self._fault(code)

    def cause_gone(self, code: int) -> None:
        """Take the cause of a persistent fault away: from now on the fault can be reset."""
        self._causes.discard(code)

    def connection_lost(self, reason: str) -> None:
        """React as the abort connection option code (6007h) says.

        0 nothing, 1 fault, 2 disable voltage, 3 quick stop.
        """
        option = self.objects.number(0x6007)
        if option == 0 or (reason in ("stopped", "reset") and self.power_state not in _POWERED):
            return
        if option == 1:
            self._fault(HEARTBEAT_LOST if reason == "heartbeat" else CONNECTION_LOST)
        elif self.power_state in _POWERED:
            self._controlword.value = 0x0002 if option == 3 else 0x0000
            self._obey()

    def _fault(self, code: int) -> None:
        self.emergency.raise_error(code)
        if code not in self._faults:
            self._faults.append(code)
        self._error_code.value = code
        if self.power_state in (PowerState.FAULT_REACTION_ACTIVE, PowerState.FAULT):
            return
        moving = self.power_state in (PowerState.OPERATION_ENABLED, PowerState.QUICK_STOP_ACTIVE)
        self._set_state(PowerState.FAULT_REACTION_ACTIVE)  # 13
        self._stop(self.objects.number(0x605E) if moving else 0, PowerState.FAULT)

    # ---- the automaton --------------------------------------------------------------------------------
    def _obey(self) -> None:
        """Follow the controlword as far as it leads."""
        word = int(self._controlword.value)
        if self._settled == (word, self.power_state):
            return
        previous, self._last_controlword = self._last_controlword, word
        while True:
            option = self.objects.number(0x605A)
            state = next_state(self.power_state, word, previous, resume_from_quick_stop=option >= 5)
            if self.power_state is PowerState.FAULT and self._causes:
                state = PowerState.FAULT
            if self._stopping and self.power_state is PowerState.OPERATION_ENABLED:
                if state is self._after_stop:
                    break  # the stop that leads there is under way
                if state is PowerState.OPERATION_ENABLED:
                    self._stopping = False  # the master has changed its mind
            if state is self.power_state:
                break
            if not self._transition(state):
                break
        self._settled = (word, self.power_state)
        self._halt(bool(word & HALT))
        self._start_or_end_homing(word, previous)
        self._refresh()

    def _transition(self, state: PowerState) -> bool:
        """Change to a state, or begin the stop that must come first (False)."""
        enabled = self.power_state is PowerState.OPERATION_ENABLED
        if enabled and state in (PowerState.SWITCHED_ON, PowerState.READY_TO_SWITCH_ON):
            option = self.objects.number(0x605C if state is PowerState.SWITCHED_ON else 0x605B)
            self._stop(option, state)
            return self.power_state is state
        if state is PowerState.QUICK_STOP_ACTIVE:
            self._set_state(state)
            option = self.objects.number(0x605A)
            self._stop(option - 4 if option >= 5 else option, None if option >= 5 else PowerState.SWITCH_ON_DISABLED)
            return True
        if self.power_state is PowerState.FAULT:
            for code in self._faults:
                self.emergency.clear_error(code)
            self._faults = []
            self._error_code.value = 0
        if state is not PowerState.OPERATION_ENABLED:
            self.homing.interrupt()
        self._set_state(state)
        return True

    def _set_state(self, state: PowerState) -> None:
        self.power_state = state
        self._stopping = False
        if state not in _MOVING:
            self._permille = 0
        self._refresh()

    def _stop(self, option: int, after: PowerState | None) -> None:
        """Begin the stop of an option of 605Ah to 605Eh.

        0 switch off, 1 slow-down ramp, 2 quick-stop ramp, 3 and 4 as hard as the limits allow.
        """
        if option == 0:
            self._set_state(after if after is not None else PowerState.SWITCH_ON_DISABLED)
            return
        self.homing.interrupt()
        self._after_stop = after
        self._stopping = True
        self._stop_began_s = self.now_s
        self._deceleration = self._ramp(option)
        self._loop.start(self._speed.counts_s if math.isfinite(self._deceleration) else 0.0, self._permille)

    def _ramp(self, option: int) -> float:
        return {1: self.objects.number(0x6084), 2: self.objects.number(0x6085)}.get(option, math.inf)

    def _halt(self, asked: bool) -> None:
        if asked and not self._halted and self.power_state is PowerState.OPERATION_ENABLED:
            self.homing.interrupt()
            self._deceleration = self._ramp(self.objects.number(0x605D))
            self._loop.start(self._speed.counts_s if math.isfinite(self._deceleration) else 0.0, self._permille)
        self._halted = asked

    # ---- modes ----------------------------------------------------------------------------------------
    def _choose_mode(self) -> None:
        if self._mode.value in MODES and self._mode_display.value != self._mode.value:
            self._mode_display.value = self._mode.value
            self.homing.interrupt()
            self._loop.start(0.0, self._permille)
            self._refresh()

    def _start_or_end_homing(self, word: int, previous: int) -> None:
        if self._mode_display.value != HOMING_MODE or self.power_state is not PowerState.OPERATION_ENABLED:
            return
        if not word & HOMING_START:
            self.homing.interrupt()
        elif not previous & HOMING_START and not self._halted:
            self.homing.start(self.objects.number(0x6098), self._absolute)
            self._loop.start(self._speed.counts_s, self._permille)
            self._take_home()

    def _take_home(self) -> None:
        if self.homing.state is HomingState.ATTAINED and self._offset != self.objects.number(0x607C) - self.homing.home_counts:
            self._offset = self.objects.number(0x607C) - self.homing.home_counts
            self._position.value = wrap_32(self._absolute + self._offset)

    # ---- one sample -----------------------------------------------------------------------------------
    def command(self) -> float:
        """Return the effort on the motor from this sample on, in the drive's unit, in steps of 1/1000 of the rated value."""
        self._obey()
        if self._mode.value != self._mode_display.value:
            self._choose_mode()
        self._limited = False
        state = self.power_state
        if self._stopping:
            self._permille = self._regulate(0.0, self._deceleration)
            self._finish_stop()
        elif state is not PowerState.OPERATION_ENABLED:
            self._permille = 0
        elif self._halted:
            self._permille = self._regulate(0.0, self._deceleration)
        elif self._mode_display.value == TORQUE_MODE:
            limit = min(int(self._max_torque.value), int(self._max_current.value))
            target = int(self._target.value)
            self._permille = min(max(target, -limit), limit)
            self._limited = self._permille != target
        elif self._mode_display.value == HOMING_MODE:
            self._permille = self._home()
        else:
            self._permille = 0
        self._demand.value = self._permille
        return self._permille * self._effort_per_permille

    def foreseen(self) -> float:
        """Return what `command` will return at the next SYNC unless something happens until then.

        It is a prediction and changes nothing.
        """
        if self.power_state is not PowerState.OPERATION_ENABLED or self._mode_display.value != TORQUE_MODE:
            return self._permille * self._effort_per_permille
        limit = min(int(self._max_torque.value), int(self._max_current.value))
        return min(max(int(self.after_sync(self._target)), -limit), limit) * self._effort_per_permille

    def _home(self) -> int:
        speed = 0.0
        if self.homing.running:
            search, zero = self.objects.number(0x6099, 1), self.objects.number(0x6099, 2)
            speed = self.homing.update(self._absolute, search, zero, self._loop.standing)
            self._take_home()
        return self._regulate(speed, self.objects.number(0x609A))

    def _regulate(self, speed: float, ramp: float) -> int:
        limit = min(int(self._max_torque.value), int(self._max_current.value))
        torque = round(self._loop.torque(speed, min(ramp, 1e12), self._speed.counts_s, limit))
        self._limited = abs(torque) >= limit
        return torque

    def _finish_stop(self) -> None:
        after = self._after_stop
        if after is not None and (self._loop.standing or self.now_s - self._stop_began_s >= STOP_TIMEOUT_S):
            self._after_stop = None
            self._set_state(after)  # 5, 8, 12 or 14
            self._obey()

    def latch(self, counts: int, effort: float, temperature_degC: float) -> None:
        """Take the sensors' readings at this sample.

        They are the motor-side counter, the measured current in the drive's unit and the winding temperature (NaN: none).
        """
        self._absolute = absolute = self._origin + counts * self.settings.sign
        self._speed.update(absolute)
        self._position.value = wrap_32(absolute + self._offset)
        self._velocity.value = wrap_32(round(self._speed.counts_s))
        permille = round(effort * self._permille_per_effort)
        self._torque.value = self._current.value = min(max(permille, -_INT16), _INT16)
        self._check_temperature(temperature_degC)
        reference = self.homing.reference
        self._inputs.value = reference.at_negative_switch(absolute) | reference.at_positive_switch(absolute) << 1
        self._refresh()

    def _check_temperature(self, temperature_degC: float) -> None:
        if temperature_degC == self._last_temperature_degC or temperature_degC != temperature_degC:
            return
        self._last_temperature_degC = temperature_degC
        tenths = min(max(round(temperature_degC * 10.0), -_INT16), _INT16)
        self._temperature.value = tenths
        self._warm = tenths >= self.objects.number(0x2001, 1)
        if tenths >= self.objects.number(0x2001, 2):
            self.inject_fault(OVERTEMPERATURE, persistent=True)
        elif self._causes:
            self._causes.discard(OVERTEMPERATURE)

    def _refresh(self) -> None:
        """Update the statusword."""
        word = int(self.power_state) | VOLTAGE_ENABLED | REMOTE
        if self._warm:
            word |= WARNING
        if self._limited:
            word |= INTERNAL_LIMIT
        mode = self._mode_display.value
        if self._halted or self._stopping:
            word |= TARGET_REACHED if self._loop.standing else 0
        elif mode == TORQUE_MODE and self.power_state is PowerState.OPERATION_ENABLED:
            word |= FOLLOWS_COMMAND
        if mode == HOMING_MODE:
            word |= self._homing_bits()
        self._statusword.value = word

    def _homing_bits(self) -> int:
        """Return bits 10, 12 and 13 of the homing mode (IEC 61800-7-201, table 105)."""
        state = self.homing.state
        if state is HomingState.ATTAINED:
            return HOMING_ATTAINED | TARGET_REACHED
        if state is HomingState.FAILED:
            return HOMING_ERROR | TARGET_REACHED
        return 0 if self.homing.running else TARGET_REACHED


def wrap_32(value: int) -> int:
    """Return the value of a signed counter of 32 bits."""
    return (value + 0x8000_0000 & 0xFFFF_FFFF) - 0x8000_0000

"""CiA 402 servo drive: finite state automaton, modes of operation, stops and faults.

The machine calls `command` and `latch` once per sample: `command` returns the effort the motor feels from that instant on, then `latch`
takes the sensors' readings.
"""

from __future__ import annotations

import math
from collections.abc import Container
from functools import partial
from pathlib import Path
from typing import cast

from drivers.canopen.eds import load_object_dictionary
from virtual_bus.canopen import abort
from virtual_bus.canopen.abort import SdoAbortError
from virtual_bus.canopen.homing import SUPPORTED_METHODS, Homing, Reference
from virtual_bus.canopen.modes import modes_of
from virtual_bus.canopen.modes.mode import TARGET_REACHED, Mode, Read
from virtual_bus.canopen.node import Emit, Node
from virtual_bus.canopen.objects import Value, key_of
from virtual_bus.canopen.power_state import HALT, PowerState, next_state
from virtual_bus.canopen.servo import Servo
from virtual_bus.errors import EmulatorError
from virtual_bus.settings import EmulatedDrive

VOLTAGE_ENABLED, WARNING, REMOTE, INTERNAL_LIMIT = 1 << 4, 1 << 7, 1 << 9, 1 << 11
TRAPEZOIDAL = 0  # the one type of 6086h
SLOW_DOWN_RAMP, QUICK_STOP_RAMP = 1, 2  # option codes of 605Ah to 605Eh, the standard's where a device has no such object
NEEDED = (0x6040, 0x6041, 0x6060, 0x6061, 0x6064)
OWN_PRODUCT = 0x49534F01  # whose data sheet has the winding's temperature at 2000h
OVERCURRENT, OVERTEMPERATURE, HEARTBEAT_LOST, CONNECTION_LOST = 0x2310, 0x4310, 0x8130, 0x8100  # EMCY codes
STOP_TIMEOUT_S = 5.0  # a motor that has not come to rest by then is switched off
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

    volatile = frozenset({0x603F, 0x6040, 0x6060, 0x6071, 0x607A, 0x60B0, 0x60B1, 0x60B2, 0x60FF})

    def __init__(self, settings: EmulatedDrive, period_s: float, emit: Emit, memory: Path | None = None) -> None:
        super().__init__(load_object_dictionary(settings.eds, settings.node_id), settings.node_id, emit, memory)
        self.settings = settings
        self._period_s = period_s
        self._sign = settings.sign
        self._effort_per_permille = settings.sign * settings.rated / 1000.0
        self._permille_per_effort = 1.0 / self._effort_per_permille
        self.factory_setting(0x6072, 0, int(1000.0 * settings.limit / settings.rated))
        self.factory_setting(0x6073, 0, int(1000.0 * settings.limit / settings.rated))
        self.factory_setting(0x6075, 0, settings.rated_current_mA)
        self.factory_setting(0x6076, 0, settings.rated_torque_mNm)
        negative, positive = self._counts(settings.negative_switch), self._counts(settings.positive_switch)
        self.homing = Homing(Reference(settings.counts_per_turn, negative, positive))
        self._check_objects()
        self.servo = Servo(self.objects, settings, period_s)
        entry = self.servo.entry
        self._controlword, self._statusword, self._error_code = entry(0x6040), entry(0x6041), entry(0x603F)
        self._mode, self._mode_display = entry(0x6060), entry(0x6061)
        self._demand, self._torque, self._current, self._inputs = entry(0x6074), entry(0x6077), entry(0x6078), entry(0x60FD)
        self._temperature = self.objects.get(0x2000) if self.objects.number(0x1018, 2) == OWN_PRODUCT else None
        self._modes = modes_of(self.servo, lambda: self.homing)
        self.factory_setting(0x6502, 0, sum(1 << mode.supported_bit for mode in self._modes.values() if mode.supported_bit >= 0))
        self._install_checks()
        self.power_state = PowerState.NOT_READY_TO_SWITCH_ON
        self._state_word, self._enabled = int(self.power_state), False
        self._causes: set[int] = set()  # of persistent faults: no reset while one is there
        self._clear()

    def _check_objects(self) -> None:
        lacking = [f"{index:04X}h" for index in NEEDED if index not in self.objects]
        if lacking:
            raise EmulatorError(f"{self.settings.eds}: no data sheet of a CiA 402 drive: it lacks {', '.join(lacking)}")

    def _install_checks(self) -> None:
        for index, allowed in ((0x6060, self._modes), (0x6086, {TRAPEZOIDAL}), (0x6098, SUPPORTED_METHODS)):
            self.objects.checks[key_of(index)] = partial(_one_of, allowed)
        self.objects.effects[key_of(0x6040)] = self._obey
        self.objects.effects[key_of(0x6060)] = lambda value: self._choose_mode()

    def _counts(self, position: float | None) -> int | None:
        return None if position is None else round(position / self.settings.position_resolution) * self.settings.sign

    # ---- life -----------------------------------------------------------------------------------------
    def place(self, position: float) -> None:
        """Place the axis at this joint position [rad or m], with the drive's counter at zero.

        Index pulse and switches stand where they are; the counter does not know the position.
        """
        self.servo.place(self._counts(position) or 0)

    def application_reset(self) -> None:
        """Switch the power stage off, set the position counter to zero, and forget the home position."""
        self._active.leave()
        self.servo.restart()
        self.homing.reset()
        self._clear()
        self._set_state(PowerState.SWITCH_ON_DISABLED)  # transitions 0 and 1

    def _clear(self) -> None:
        self._settled: PowerState | None = None  # state from which no transition follows with this controlword:
        self._last_controlword = 0
        self._after_stop: PowerState | None = None
        self._stopping = self._halted = self._warm = False
        self._steady, self._steady_word = False, 0  # whether the statusword stays as it was while no limit acts
        self._stop_began_s = 0.0
        self.servo.permille, self.servo.limited = 0, False
        self._active = self._modes[0]
        self._in_charge: Mode | None = None  # who gave the last torque; None: a stop, a halt, nobody
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
            self._controlword.value = word = 0x0002 if option == 3 else 0x0000
            self._obey(word)

    def _fault(self, code: int) -> None:
        self.emergency.raise_error(code)
        if code not in self._faults:
            self._faults.append(code)
        self._error_code.value = code
        if self.power_state in (PowerState.FAULT_REACTION_ACTIVE, PowerState.FAULT):
            return
        moving = self.power_state in (PowerState.OPERATION_ENABLED, PowerState.QUICK_STOP_ACTIVE)
        self._set_state(PowerState.FAULT_REACTION_ACTIVE)  # 13
        self._stop(self.objects.number(0x605E, 0, QUICK_STOP_RAMP) if moving else 0, PowerState.FAULT)

    # ---- the automaton --------------------------------------------------------------------------------
    def _obey(self, controlword: Value) -> None:
        """Follow the controlword as far as it leads."""
        if controlword == self._last_controlword and self._settled is self.power_state:
            return
        word = int(controlword)
        previous, self._last_controlword = self._last_controlword, word
        while True:
            option = self.objects.number(0x605A, 0, QUICK_STOP_RAMP)
            state = next_state(self.power_state, word, previous, resume_from_quick_stop=option >= 5)
            if self.power_state is PowerState.FAULT and self._causes:
                state = PowerState.FAULT
            if self._stopping and self._enabled:
                if state is self._after_stop:
                    break  # the stop that leads there is under way
                if state is PowerState.OPERATION_ENABLED:
                    self._stopping = False  # the master has changed its mind
            if state is self.power_state:
                break
            if not self._transition(state):
                break
        self._settled = self.power_state
        self._halt(self._enabled and bool(word & HALT))
        if self._enabled:
            self._active.obey(word, previous, halted=self._halted)
        self._refresh()

    def _transition(self, state: PowerState) -> bool:
        """Change to a state, or begin the stop that must come first (False)."""
        if self._enabled and state in (PowerState.SWITCHED_ON, PowerState.READY_TO_SWITCH_ON):
            disables = state is PowerState.SWITCHED_ON
            option = self.objects.number(0x605C, 0, SLOW_DOWN_RAMP) if disables else self.objects.number(0x605B)
            self._stop(option, state)
            return self.power_state is state
        if state is PowerState.QUICK_STOP_ACTIVE:
            self._set_state(state)
            option = self.objects.number(0x605A, 0, QUICK_STOP_RAMP)
            self._stop(option - 4 if option >= 5 else option, None if option >= 5 else PowerState.SWITCH_ON_DISABLED)
            return True
        if self.power_state is PowerState.FAULT:
            for code in self._faults:
                self.emergency.clear_error(code)
            self._faults = []
            self._error_code.value = 0
        if state is not PowerState.OPERATION_ENABLED:
            self._active.leave()
        self._set_state(state)
        return True

    def _set_state(self, state: PowerState) -> None:
        self.power_state = state
        self._state_word = int(state) | VOLTAGE_ENABLED | REMOTE
        self._enabled = state is PowerState.OPERATION_ENABLED
        self._stopping = False
        self._in_charge = None
        if state not in _MOVING:
            self.servo.release()
        self._refresh()

    def _stop(self, option: int, after: PowerState | None) -> None:
        """Begin the stop of an option of 605Ah to 605Eh.

        0 switch off, 1 slow-down ramp, 2 quick-stop ramp, 3 and 4 as hard as the limits allow.
        """
        self._active.leave()
        if option == 0:
            self._set_state(after if after is not None else PowerState.SWITCH_ON_DISABLED)
            return
        self._after_stop = after
        self._stopping = True
        self._stop_began_s = self.clock.now_s
        self._start_braking(option)

    def _halt(self, asked: bool) -> None:
        if asked and not self._halted:
            self._active.halt()
            self._start_braking(self.objects.number(0x605D, 0, SLOW_DOWN_RAMP))
        self._halted = asked

    def _start_braking(self, option: int) -> None:
        self._in_charge = None
        self.servo.start_braking(option)

    # ---- modes ----------------------------------------------------------------------------------------
    def _choose_mode(self) -> None:
        """Change to the mode of 6060h; one that the drive does not have leaves it in its mode."""
        mode = self._modes.get(self._mode.value)
        if mode is None or mode is self._active:
            return
        self._active.leave()
        self._active, self._in_charge = mode, None
        self._mode_display.value = mode.number
        self.servo.show_no_demand()
        self._refresh()

    # ---- one sample -----------------------------------------------------------------------------------
    def command(self) -> float:
        """Return the effort on the motor from this sample on, in the drive's unit, in steps of 1/1000 of the rated value."""
        if (word := self._controlword.value) != self._last_controlword or self.power_state is not self._settled:
            self._obey(word)
        mode, servo = self._active, self.servo
        if self._mode.value != mode.number:
            self._choose_mode()
            mode = self._active
        servo.limited = False
        if self._in_charge is mode:  # of an enabled drive that neither stops nor halts
            servo.permille = mode.torque()
        elif self._stopping or self._halted:
            servo.permille = servo.brake()
            self._finish_stop()
        elif self._enabled:
            mode.start()
            self._in_charge, servo.released = mode, False
            servo.permille = mode.torque()
        else:
            servo.release()
        self._demand.value = permille = servo.permille
        return permille * self._effort_per_permille

    def foreseen(self) -> float:
        """Return what `command` will return at the next SYNC unless something happens until then.

        It is a prediction and changes nothing.
        """
        if not self._enabled or self._stopping or self._halted:
            return self.servo.permille * self._effort_per_permille
        mode = self._active
        return mode.foreseen(cast("Read", self.after_sync), takes_over=self._in_charge is not mode) * self._effort_per_permille

    def _finish_stop(self) -> None:
        after = self._after_stop
        if self._stopping and after is not None and (self.servo.loop.standing or self.clock.now_s - self._stop_began_s >= STOP_TIMEOUT_S):
            self._after_stop = None
            self._set_state(after)  # 5, 8, 12 or 14
            self._obey(self._controlword.value)

    def latch(self, counts: int, effort: float, temperature_degC: float) -> None:
        """Take the sensors' readings at this sample.

        They are the motor-side counter, the measured current in the drive's unit and the winding temperature (NaN: none).
        """
        servo = self.servo
        absolute = servo.latch(counts * self._sign)
        permille = round(effort * self._permille_per_effort)
        if not -_INT16 <= permille <= _INT16:
            permille = _INT16 if permille > 0 else -_INT16
        self._torque.value = self._current.value = permille
        if temperature_degC != self._last_temperature_degC:
            self._check_temperature(temperature_degC)
        self._inputs.value = self.homing.reference.switches(absolute)
        if self._steady and not servo.limited:
            self._statusword.value = self._steady_word
            return
        mode = self._active
        if mode.observes and self._enabled and not self._stopping:
            fault = mode.observe(in_charge=self._in_charge is mode)
            if fault:
                self._fault(fault)
        self._refresh()

    def _check_temperature(self, temperature_degC: float) -> None:
        if math.isnan(temperature_degC) or self._temperature is None:
            return
        self._last_temperature_degC, self._steady = temperature_degC, False
        tenths = min(max(round(temperature_degC * 10.0), -_INT16), _INT16)
        self._temperature.value = tenths
        self._warm = tenths >= self.objects.number(0x2001, 1)
        if tenths >= self.objects.number(0x2001, 2):
            self.inject_fault(OVERTEMPERATURE, persistent=True)
        elif self._causes:
            self._causes.discard(OVERTEMPERATURE)

    def _refresh(self) -> None:
        """Update the statusword."""
        word, in_charge = self._state_word, self._enabled
        if self._warm:
            word |= WARNING
        if self.servo.limited:
            word |= INTERNAL_LIMIT
        if self._halted or self._stopping:
            in_charge = False
            if self.servo.loop.standing:
                word |= TARGET_REACHED
        mode = self._active
        self._statusword.value = self._steady_word = word | mode.status(in_charge=in_charge)
        self._steady = in_charge and mode.steady and not self.servo.limited


def _one_of(allowed: Container[int], value: Value) -> None:
    """Refuse a value that is none of these."""
    if value not in allowed:
        raise SdoAbortError(abort.INVALID_VALUE)

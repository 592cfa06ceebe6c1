"""The definition of an effect: a piece of physics with a name, parameters and a place, added to a machine by an effects file."""

from __future__ import annotations

from dataclasses import dataclass

MAX_PARAMETERS = 8  # columns of a compiled effect table
PRISMATIC_UNITS = {
    "Nm": "N",
    "rad": "m",
    "rad/s": "m/s",
    "Nm/rad": "N/m",
    "Nm/rad^3": "N/m^3",
    "1/rad^2": "1/m^2",
    "Nm/rad^2": "N/m^2",
    "Nm s/rad^2": "N s/m^2",
    "Nm s/rad^3": "N s/m^3",
    "rad/Nm": "m/N",
    "Nm s/rad": "N s/m",
    "Nm s^2/rad^2": "N s^2/m^2",
    "kg m^2": "kg",
    "cycles/turn": "rad/m",
}
DRIVE_UNIT = "A"  # stands for the unit of the drive's effort
PHASE = "phase"  # an angle in rad at every joint
FORCES = ("Nm", "N", "kg", "W")  # what is larger where all efforts and inertias are


@dataclass(frozen=True)
class EffectKind:
    """How effects of one kind enter the equations: the hook that an effect's file defines, and where such effects act."""

    name: str
    function: str  # the hook's name
    allowed_at: tuple[str, ...]  # "axis", "body", "encoder", "imu", "channel"
    description: str
    needs: str = ""  # "spring": a sprung joint there; "neighbour": a further axis
    before_current: bool = False  # acts between a drive's target and the current that flows


FRICTION = EffectKind(
    "friction", "level", ("axis", "body"),
    "level(state: JointState, *parameters) -> effort [Nm or N] that opposes the joint's motion; at rest, the most it holds; a joint's "
    "frictions together are never less than nothing",
)  # fmt: skip
SHARED_FRICTION = EffectKind(
    "shared friction", "level", ("axis",),
    "level(state: JointState, *parameters), as of friction, against a motor that turns with the next axis and, by share(*parameters), this",
    "neighbour",
)  # fmt: skip
EFFORT = EffectKind("effort", "effort", ("axis", "body"), "effort(motion: JointMotion, *parameters) -> effort [Nm or N] on the joint")
ELASTIC = EffectKind(
    "elastic", "effort", ("axis", "body"),
    "as an effort, on the sprung joint behind the axis or under the body, added to its spring", "spring",
)  # fmt: skip
TRANSMISSION = EffectKind(
    "transmission", "terms", ("axis",),
    "terms(pair: PairMotion, *parameters) -> added inertia (11, 12) and efforts on the axis's joint and the spring behind it", "spring",
)  # fmt: skip
COUPLING = EffectKind(
    "coupling", "terms", ("axis",),
    "terms(pair: PairMotion, *parameters) -> added inertia (11, 12) and efforts on the axis's joint and the next axis's", "neighbour",
)  # fmt: skip
REACTION = EffectKind(
    "reaction", "react", ("axis", "body"),
    "react(state: ReactionState, *parameters) -> mean effort over a step and the effect's two states at its end",
)  # fmt: skip
LIMIT = EffectKind(
    "drive limit", "limited", ("axis",), "limited(state: DriveState, *parameters) -> current that flows [drive's unit]", before_current=True
)
SUPPLY = EffectKind(
    "drive supply", "limited", ("axis",),
    "limited(state: DriveState, *parameters), as of a drive limit, which acts after it; target(current, *parameters) -> what to ask for so "
    "that it flows at rest",
    before_current=True,
)  # fmt: skip
RIPPLE = EffectKind("drive ripple", "factor", ("axis",), "factor(state: DriveState, *parameters) -> motor effort over its nominal value")
LAG = EffectKind(
    "drive lag",
    "transition",
    ("axis",),
    "transition(step_s, *parameters) -> what is left of a current error after a step",
    before_current=True,
)
DELAY = EffectKind("drive delay", "delay_s", ("axis",), "delay_s(*parameters) -> how much later the drive acts [s]", before_current=True)
CHANGE = EffectKind("change", "CHANGES", ("axis",), "CHANGES: what becomes of numbers of the machine file")
JOINT_CHANGE = EffectKind("change", "CHANGES", ("axis", "body"), "CHANGES: what becomes of the joint's numbers")
BODY_CHANGE = EffectKind("change", "CHANGES", ("body",), "CHANGES: what becomes of numbers of the machine file")
SPRING_CHANGE = EffectKind("change", "CHANGES", ("axis", "body"), "CHANGES: what becomes of the sprung joint behind the axis", "spring")
IMU_CHANGE = EffectKind("change", "CHANGES", ("imu",), "CHANGES: what becomes of the sensor's numbers")
ENCODER_ERROR = EffectKind("encoder error", "error", ("encoder",), "error(position, *parameters) -> added to what the encoder sees")
LATTICE = EffectKind("encoder lattice", "resolution", ("encoder",), "resolution(*parameters) -> step of a further rounding")
CALIBRATION = EffectKind(
    "imu calibration", "calibration", ("imu",),
    "calibration(*parameters) -> gain (2, 3, 3) of accelerometer and gyro, and offset (6,) after it",
)  # fmt: skip
SIGN = EffectKind("channel sign", "signed", ("channel",), "signed(value, *parameters) -> the channel before noise and lattice")
CLOCK = EffectKind(
    "channel clock", "lag_s", ("axis", "channel"),
    "lag_s(time_s, *parameters) -> how old the channel's value is [s]; at an axis, that of all its encoders and its speed sensor",
)  # fmt: skip
DROPOUT = EffectKind("channel dropout", "is_lost", ("channel",), "is_lost(sample, *parameters) -> is the last reading repeated?")


def power_of_force(unit: str) -> float:
    """Return to which power a unit has a force or a mass: 1 of Nm/rad, -1 of rad/Nm, 0 of rad/s."""
    above, _, below = unit.partition("/")
    return float(any(each in FORCES for each in above.split())) - float(any(each in FORCES for each in below.split()))


@dataclass(frozen=True)
class Parameter:
    """One number of an effect, with bounds that every machine has; those of a large one are wider: see `bounds.py`."""

    name: str
    unit: str  # at a revolute joint and a drive in A; `unit_at` has its counterparts
    low: float
    high: float
    description: str
    is_strength: bool = True  # with every strength at `neutral`, the effect does nothing
    neutral: float = 0.0
    default: float | None = None  # of a file that leaves it out; None where it must not
    fixed: bool = False  # a choice, not a number that could be fitted
    small: float = 1e-6  # a step from zero that shows, and changes little
    sought: tuple[float, float] | None = None  # where the search was measured with narrower bounds: those

    def unit_at(self, prismatic: bool, drive_unit: str = DRIVE_UNIT) -> str:
        """Return the unit at a joint that turns or one that slides, behind a drive that counts in `drive_unit`."""
        if self.unit == PHASE:
            return "rad"
        unit = PRISMATIC_UNITS.get(self.unit, self.unit) if prismatic else self.unit
        if unit == DRIVE_UNIT:
            return drive_unit
        if unit == "A s/rad":
            return f"{drive_unit} s/{'m' if prismatic else 'rad'}"
        if unit == "1/A":
            return f"1/{drive_unit}"
        return unit

    def key(self, prismatic: bool = False, drive_unit: str = DRIVE_UNIT) -> str:
        """Return the name as it is written in an effects file: `Fc_Nm`, `vs_rad_s`, `delta`."""
        suffix = self.unit_at(prismatic, drive_unit).replace("/", "_").replace(" ", "_").replace("^", "")
        return f"{self.name}_{suffix}" if suffix else self.name


@dataclass(frozen=True)
class Effect:
    """One kind of physics by name. Its file is virtual_bus/effects/<name>.py and holds EFFECT, the kind's hook and `laws`."""

    name: str
    plain: str  # what it is, in at most 25 words for a reader who is no specialist
    kind: EffectKind
    parameters: tuple[Parameter, ...]
    equation: str
    convention: str  # sign, half or full gap, which side of the gear
    neighbours: tuple[str, ...]  # what it is mistaken for
    source: str
    family: str  # effects that recordings often tell apart from all others but not from each other
    parent: str = ""  # the effect that this one refines
    everyday: bool = False  # what an engineer's first fit has at every driven joint
    play: str = ""  # the parameter that is half of what two encoders of its axis lie apart by
    is_exact: bool = False  # a law of mechanics or of a sensor, whose form is known: not an empirical curve
    is_slow: bool = False  # takes minutes: recordings of seconds show next to nothing of it, so a diagnosis does not look for it
    several: str = ""  # the parameter in which several at one place differ; "" where there is but one
    sought_at: tuple[str, ...] | None = None
    """Kinds of places where a diagnosis looks for it; None: wherever it may act.

    The search along the motion was measured without effects and places that were added since: it answers otherwise when it is offered more.
    """
    left_out: str = ""
    """Why a linear model about rest does not hold it; "" where small motions follow its linear part."""
    left_out_of: tuple[str, ...] = ()
    """Parameters that a linear model takes as neutral for that reason, while it holds the rest; none: it holds nothing of the effect."""

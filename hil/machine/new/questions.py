"""The questions of `isocenter machine new`, and a draft made of their answers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from hil.errors import UnusableInputError
from hil.machine.new.draft import Answers, Draft, DraftAxis, DraftBody, Question, Value
from hil.machine.new.readers import direction, names_of, number, numbers, one_of, whole

SHOWN_UNIT = {"revolute": ("deg", 57.29577951308232), "prismatic": ("mm", 1000.0)}
"""Unit in which people say positions of an axis, and how many of it are in one of SI."""

TRACKING_ERROR = Value(3.0, "as of the C-arm")
"""Tracking error [deg or mm] at which a new axis stops."""

METHODS = "homing method of CiA 402: 1 or 17 goes to the negative limit switch, 2 or 18 to the positive one"

POSITIVE = number(0.0, above=True)


@dataclass(frozen=True)
class KnownDrive:
    """What a model says of a drive: its gear, what turns with the rotor seen at the joint, and its largest command and range."""

    ratio: float | None = None
    armature: float = 0.0  # kg m^2 or kg, at the joint
    limit: float | None = None  # Nm or N at the motor
    range: tuple[float, float] | None = None  # rad or m


class _Ask:
    """Asks for what concerns one axis."""

    def __init__(self, answers: Answers, axis: str) -> None:
        self._answers, self._axis = answers, axis

    def __call__(self, key: str, words: str, read: Callable[[str], object], otherwise: Value | None = None) -> Value:
        return self._answers.take(Question(f"{self._axis}.{key}", f"{self._axis}: {words}", read, otherwise))


def draft_of(answers: Answers, name: str) -> Draft:
    """Return the draft of a machine of which nothing is known: a chain of bodies, one an axis."""
    words = "Names of the axes, from the base outwards, with commas between them"
    axes = answers.take(Question("axes", words, names_of))
    if not isinstance(axes.value, list):
        raise UnusableInputError("no axes: name them, `-a axes=turn,lift`, or give a model, `--from MODEL`")
    down = Value([0.0, 0.0, -9.81], "z points up")
    gravity = answers.take(Question("gravity_m_s2", "Gravity in the world, three numbers [m/s^2]", numbers(3), down))
    rate = rate_of(answers)
    bodies, drafts, parent = [], [], "world"
    for axis in axes.value:
        body, draft = _body(_Ask(answers, axis), axis, parent)
        bodies.append(body)
        drafts.append(draft)
        parent = body.name
    return Draft(name, "", "answers", rate, gravity, bodies, drafts)


def rate_of(answers: Answers) -> Value:
    """Ask for the sample rate."""
    return answers.take(Question("sample_rate_Hz", "Sample rate of the loop [Hz]", POSITIVE, Value(256.0, "as of the C-arm")))


def _body(ask: _Ask, axis: str, parent: str) -> tuple[DraftBody, DraftAxis]:
    """Return the body that an axis moves."""
    kind = ask("type", "does it turn or slide? revolute or prismatic", one_of("revolute", "prismatic"), Value("revolute", "it turns"))
    turns = kind.value == "revolute"
    origin, balanced = Value([0.0, 0.0, 0.0], f"at the origin of {parent}"), Value([0.0, 0.0, 0.0], "balanced")
    none = Value(0.0, "none, which `isocenter diagnose` would find")
    joint = {
        "name": Value(axis),
        "type": kind,
        "axis": ask("axis", "direction of its axis: x, y, z or three numbers", direction, Value([0.0, 0.0, 1.0], "upright")),
        "damping_Nm_s_rad" if turns else "damping_N_s_m": ask(
            "damping", f"viscous friction [{'Nm s/rad' if turns else 'N s/m'}]", number(0.0), none
        ),
    }
    values = {
        "position_m": ask("position_m", f"its origin in the frame of {parent}, three numbers [m]", numbers(3), origin),
        "mass_kg": ask("mass_kg", "mass that it moves, without the axes that it carries [kg]", POSITIVE),
        "center_of_mass_m": ask("center_of_mass_m", "centre of mass from its origin, three numbers [m]", numbers(3), balanced),
    }
    if turns or parent != "world":
        words = "inertia about its centre of mass [kg m^2]: Ixx,Iyy,Izz or one number for all three"
        inertia = ask("inertia_kg_m2", words, numbers(1, 3))
        if isinstance(inertia.value, list):
            moments = inertia.value if len(inertia.value) == 3 else inertia.value * 3
            inertia = Value([*moments, 0.0, 0.0, 0.0], "the same about every axis" if len(inertia.value) == 1 else "")
        values["inertia_kg_m2"] = inertia
    return DraftBody(f"{axis}_body", parent, values, joint), DraftAxis(axis, axis, str(kind.value))


def ask_drive(answers: Answers, axis: DraftAxis, known: KnownDrive | None, with_bus: bool) -> None:
    """Fill in an axis's drive, and for a bus its limits, node and homing: by a model where there is one, and by answers."""
    ask, turns = _Ask(answers, axis.name), axis.kind == "revolute"
    force = "Nm" if turns else "N"
    current = Value("A", "current, as for most servo drives")
    otherwise = current if known is None else Value(force, "the model's actuators take it")
    unit = ask("effort_unit", f"unit of the drive's command: A, V or {force}", one_of("A", "V", force), otherwise)
    effort = str(unit.value)
    unity = Value(1.0, f"the command is the motor's {force}") if effort == force else None
    constant = ask("constant", f"effort of the motor for each {effort} of command [{force}/{effort}]", POSITIVE, unity)
    direct = Value(1.0, "direct drive")
    gear = direct if known is None or known.ratio is None else Value(known.ratio, "of the model", is_known=True)
    ratio = ask("ratio", "turns of the motor for each of the joint" if turns else "gear ratio", POSITIVE, gear)
    assert isinstance(ratio.value, float)
    rotor = "rotor_inertia_kg_m2" if turns else "rotor_mass_kg"
    armature = None if known is None else Value(float(f"{known.armature / ratio.value**2:.12g}"), "the model's armature", is_known=True)
    words = "inertia of the motor's rotor [kg m^2]" if turns else "mass of the motor's moving part [kg]"
    inertia = ask(rotor, words, number(0.0), armature or Value(0.0, "none beside the body's"))
    most = Value(known.limit, "of the model", is_known=True) if known is not None and known.limit and effort == force else None
    limit = ask("limit", f"largest command of the drive [{effort}]", POSITIVE, most)
    axis.drive = {"joint": Value(axis.joint), "effort_unit": unit, "constant": constant, "constant_unit": Value(f"{force}/{effort}")}
    axis.drive |= {"ratio": ratio, rotor: inertia, f"limit_{effort}": limit}
    if with_bus:
        of = "current" if effort == "A" else "effort"
        words = f"rated {of} of the drive, which its per mille refer to [{effort}]"
        axis.drive[f"rated_{of}_{effort}"] = ask("rated", words, POSITIVE)
        axis.drive["target_resolution_permille"] = Value(1.0, "targets of CiA 402 are whole per mille", is_known=True)
    smooth = None if with_bus else Value(0, "an encoder without steps")
    counts = ask("encoder_counts_per_motor_turn", "counts of the motor's encoder for each of its turns", whole(1, 2**40), smooth)
    if counts.value != 0:
        axis.drive["encoder_counts_per_motor_turn"] = counts
    if with_bus:
        force_words = f"effort that its closed brake holds, at the joint [{force}]; 0 is no brake"
        axis.brake = {f"brake_effort_{force}": ask("brake_effort", force_words, number(0.0))}
        _ask_limits(ask, axis, known)
        _ask_node(ask, axis, limit.value, effort)


def _ask_limits(ask: _Ask, axis: DraftAxis, known: KnownDrive | None) -> None:
    """Ask for the limits that a machine on a bus needs."""
    unit, per_SI = SHOWN_UNIT[axis.kind]
    span = None
    if known is not None and known.range is not None:
        span = Value([float(f"{per_SI * end:.9g}") for end in known.range], "of the model", is_known=True)
    speed = ask(f"speed_{unit}_s", f"highest speed [{unit}/s]", POSITIVE)
    fast = speed.value if isinstance(speed.value, float) else None
    axis.limits = {
        f"range_{unit}": ask(f"range_{unit}", f"lowest and highest position, two numbers [{unit}]", numbers(2), span),
        f"speed_{unit}_s": speed,
        f"acceleration_{unit}_s2": ask(
            f"acceleration_{unit}_s2",
            f"highest acceleration [{unit}/s^2]",
            POSITIVE,
            None if fast is None else Value(fast, "full speed after 1 s"),
        ),
        f"jerk_{unit}_s3": ask(
            f"jerk_{unit}_s3",
            f"highest jerk [{unit}/s^3]",
            POSITIVE,
            None if fast is None else Value(5.0 * fast, "full acceleration after 0.2 s"),
        ),
        f"tracking_error_{unit}": ask(
            f"tracking_error_{unit}", f"difference of reference and position that stops it [{unit}]", POSITIVE, TRACKING_ERROR
        ),
    }


def _ask_node(ask: _Ask, axis: DraftAxis, limit: object, effort: str) -> None:
    """Ask for node number and homing."""
    unit, _ = SHOWN_UNIT[axis.kind]
    axis.node["node_id"] = ask("node_id", "node number of its drive", whole(1, 126), axis.node["node_id"])
    method = None
    if axis.link:
        method = Value(37, "the link encoder says where it is")
        axis.link["node_id"] = ask("link_node_id", "node number of its link encoder", whole(1, 126), axis.link["node_id"])
        words = "counts of the link encoder for each turn of the joint" if unit == "deg" else "step of the link encoder [m]"
        key, read = ("counts_per_turn", whole(1, 2**40)) if unit == "deg" else ("resolution_m", POSITIVE)
        axis.link[key] = ask(f"link_{key}", words, read)
        counts = axis.link[key].value
        zero = Value(counts // 2 if isinstance(counts, int) else 2**31, "the middle of its range at position zero")
        axis.link["zero_counts"] = ask("link_zero_counts", "counts of the link encoder at position zero", whole(0, 2**32 - 1), zero)
    tenth = Value(float(f"{0.1 * limit:.4g}"), "a tenth of the limit") if isinstance(limit, float) else None
    words = f"effort beyond holding that moves it a little, for the check of its direction [{effort}]"
    axis.homing = {
        "method": ask("homing_method", METHODS, whole(-128, 37), method),
        f"speed_{unit}_s": Value(2.0, "slow"),
        f"acceleration_{unit}_s2": Value(10.0, "gentle"),
        "timeout_s": Value(60.0, "a minute"),
        f"agreement_tolerance_{unit}": Value(0.5, "of motor side and link encoder, where there is one"),
        f"direction_check_effort_{effort}": ask("direction_check_effort", words, POSITIVE, tenth),
        f"direction_check_travel_{unit}": Value(0.1, "far above an encoder's step"),
        "direction_check_timeout_s": Value(2.0, "so long may the push last"),
    }

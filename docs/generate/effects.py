"""The reference of effects, from the registry of `virtual_bus.effects`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from docs.generate.docstrings import paragraphs
from docs.generate.markdown import block, code, number, sentence, table
from docs.generate.markdown import page as whole
from virtual_bus.effects.effect import Effect, EffectKind, Parameter
from virtual_bus.effects.registry import effects, module_of

INTRODUCTION = """
An effect is a piece of physics with a name, such as Coulomb friction, that an effects file adds to a machine. This
page lists every effect: its law, parameters, units and ranges, where it may act, and the effects it is mistaken for.
`emulate`, `run --bus lockstep:` and `simulate` take an effects file with `--effects`; `diagnose` writes one. A machine
file states effects in the same `[[effect]]` tables.
`isocenter effects --json` prints this catalogue for programs. To write a new effect see [Add an
effect](../how-to/add-an-effect.md).
"""

EXAMPLE = """
format = 1

[[effect]]
name = "coulomb_friction"
at = "roll"
Fc_Nm = 12.0
"""

FILE_TEXT = """
`format` is 1 and may be left out. A file without `[[effect]]` tables adds nothing. `name`, `at` and all parameters
are required, except parameters whose default is given below. A parameter's key ends in its unit. At a joint that
slides the key has the unit of the column "sliding joint"; at a drive that is not commanded in ampere, the drive's
unit stands in place of `A`.

`at` is a name of the machine file of the kind that the catalogue gives:
"""

PLACES = (
    ("axis", "an axis, such as `roll`"),
    ("body", "a body; the effect acts on the joint that carries it"),
    ("encoder", "the channel of an encoder, such as `link_position_roll`"),
    ("imu", "the IMU"),
    ("channel", "any channel of an encoder, a speed or current sensor or an IMU; `imu` is all channels of the IMU"),
)

STRENGTH_TEXT = """
`scatter_percent`, in any effect, is the standard deviation by which its strengths differ from run to run: the emulator
draws them at its start, from its seed. `simulate` takes the stated values. `KEY_between = [least, most]`, beside a
parameter, is where it lies on one machine or another: the observer counts that.

An effect may act once at a place, unless its section says that several may. Parameters marked *strength* turn the
effect off: with all of them at the neutral value the machine is the same bit for bit. Time in an effect counts from
row 0 in `simulate`, and from the emulator's start on a bus, so an effect that depends on time has another phase
there.

Ranges are those that every machine takes. Where a joint has more effort, inertia or travel, they reach further: as far
as ten times the effort that drives and weight bring to it or the inertia that moves with it, a damper that stops that
inertia within a row, and a spring on which it swings at half the rows' rate.
"""

KINDS_TEXT = """
An effect's kind says how it enters the equations of motion. The last column is the function that the effect's file
defines; what is numerically done with it is in [The emulated plant](../explanation/plant.md).
"""


def page() -> str:
    """Write the page."""
    catalogue = effects()
    rows = ((f"[{code(name)}](#{name.replace('_', '-')})", _places(each), code(each.equation)) for name, each in catalogue.items())
    parts = [INTRODUCTION, "## Effects file", block(EXAMPLE, "toml"), FILE_TEXT, table(("`at`", "means"), PLACES), STRENGTH_TEXT]
    parts += ["## Overview", table(("effect", "acts at", "law"), rows)]
    parts += ["## Kinds", KINDS_TEXT, table(("kind", "acts at", "function"), _kinds(catalogue.values()))]
    parts.append("## Catalogue")
    for name, each in catalogue.items():
        parts += [f"({name.replace('_', '-')})=\n### {name}", *_effect(each)]
    return whole("Effects", *parts)


def _effect(effect: Effect) -> Iterator[str]:
    yield effect.plain
    yield " ".join(paragraphs(module_of(effect.name))[:1])
    facts = [
        ("law", code(effect.equation)),
        ("acts at", _places(effect)),
        ("kind", effect.kind.name),
        ("convention", effect.convention),
        ("sought by `diagnose`", _sought(effect)),
        ("mistaken for", ", ".join(f"[{code(name)}](#{name.replace('_', '-')})" for name in effect.neighbours)),
        ("source", effect.source),
    ]
    if effect.several:
        facts.insert(2, ("several at one place", f"yes, each with another {code(effect.several)}"))
    yield table(("", ""), facts)
    header = ("key", "sliding joint", "unit", "range", "default", "role", "meaning")
    yield table(header, (_parameter(parameter) for parameter in effect.parameters))


def _parameter(parameter: Parameter) -> tuple[str, ...]:
    sliding = parameter.key(prismatic=True)
    return (
        code(parameter.key()),
        "" if sliding == parameter.key() else code(sliding),
        parameter.unit_at(prismatic=False),
        f"{number(parameter.low)} to {number(parameter.high)}",
        "required" if parameter.default is None else number(parameter.default),
        f"strength, neutral at {number(parameter.neutral)}" if parameter.is_strength else "",
        sentence(parameter.description),
    )


def _places(effect: Effect) -> str:
    needs = {"spring": " with a sprung joint", "neighbour": " with a further axis"}.get(effect.kind.needs, "")
    return ", ".join(effect.kind.allowed_at) + needs


def _sought(effect: Effect) -> str:
    at = effect.kind.allowed_at if effect.sought_at is None else effect.sought_at
    return "no" if effect.is_slow or not at else "at: " + ", ".join(at)


def _kinds(all_effects: Iterable[Effect]) -> Iterator[tuple[str, str, str]]:
    kinds: dict[EffectKind, None] = dict.fromkeys(each.kind for each in all_effects)
    for kind in sorted(kinds, key=lambda kind: (kind.name, kind.allowed_at)):
        function, arrow, result = kind.description.partition(" -> ")
        said = f"{code(function)}: {result}" if arrow else kind.description
        yield kind.name, ", ".join(kind.allowed_at), said

"""Options that are written once: as the fields of a dataclass that several commands take, or as the parts of a verb's request."""

from __future__ import annotations

import collections.abc
import dataclasses
import inspect
import typing
from collections.abc import Callable, Sequence
from inspect import Parameter
from typing import Annotated, Any

import typer

from hil.cli.options import parse_band, parse_modes, parse_orders, parse_over_axis, parse_point, parse_pose, parse_whole_numbers
from hil.verbs.verb import Option

Command = Callable[..., None]

FORMS: dict[str, Callable[[str, str], object]] = {
    "LOW:HIGH": parse_band,
    "N_n,N_m,N_d": parse_orders,
    "Q_n,Q_d,P[,SYMMETRY]": parse_over_axis,
    "X,Y,Z": parse_point,
    "N,N,...": parse_whole_numbers,
    "modes": parse_modes,
    "NAME,...": lambda _, text: tuple(name.strip() for name in text.split(",") if name.strip()),
}
"""How text is read, by its form or metavar."""

A_POSE = "AXIS=VALUE,..."
"""Metavar of what is read in the units of the request's machine."""

SCALES = {"MM": 1e-3, "MS": 1e-3}
"""Units of the command line in SI, by their metavar."""


def takes(options: type) -> Callable[[Command], Command]:
    """Decorate a command: the parameter annotated with this dataclass becomes one option per field, behind the command's own.

    Parameters
    ----------
    options : type
        A dataclass; each field's annotation and default are those of its option.
    """

    def decorate(command: Command) -> Command:
        own, shared = _parameters(command), _parameters(options)
        place = next(each.name for each in own if each.annotation is options)

        def run(**given: object) -> None:
            taken = options(**{each.name: given.pop(each.name) for each in shared})
            command(**given, **{place: taken})

        return _as_command(command, [each for each in own if each.name != place] + shared, run)

    return decorate


def asks(command: Command) -> Command:
    """Decorate a command: the parameter annotated `Callable[..., Request]` becomes an option for every part of it that is an option.

    The command calls it with the other parts and has the request.
    """
    own = _parameters(command)
    place = next(k for k, each in enumerate(own) if typing.get_origin(each.annotation) is collections.abc.Callable)
    request = typing.get_args(own[place].annotation)[1]
    parts = _options(request)

    def run(**given: Any) -> None:  # noqa: ANN401 - what is typed
        typed = {part: given.pop(part.name) for part in parts}

        def made(**others: Any) -> object:  # noqa: ANN401 - parts of any kind
            return request(**others, **{part.name: _read(part, text, others.get("machine")) for part, text in typed.items()})

        command(**given, **{own[place].name: made})

    return _as_command(command, [*own[:place], *map(_typed, parts), *own[place + 1 :]], run)


def names_of(request: type) -> dict[str, str]:
    """Return the option of each part of a request, without its dashes."""
    options = {part.name: part.metadata["option"].names for part in _options(request)}
    return {part: max(names, key=len).lstrip("-") for part, names in options.items() if names}


def _options(request: type) -> list[dataclasses.Field[Any]]:
    return [each for each in dataclasses.fields(request) if "option" in each.metadata]


def _typed(part: dataclasses.Field[Any]) -> Parameter:
    """Return a part as Typer wants it."""
    told: Option = part.metadata["option"]
    is_read = (told.form or told.metavar) in {*FORMS, A_POSE}
    kind: Any = str if is_read else told.kind
    default: Any = part.default
    if told.is_several:
        kind, default = list[kind], None
    elif is_read:
        default = (":" if told.metavar == "LOW:HIGH" else ",").join(f"{number:g}" for number in default or ())
    elif told.none is not None:
        default = told.none
    elif told.metavar in SCALES:
        default /= SCALES[told.metavar]
    if told.is_needed:
        default = Parameter.empty
    elif default is None:
        kind |= None
    if told.names:
        how: object = typer.Option(*told.names, metavar=told.metavar, help=told.help, min=told.least, max=told.most)
    else:
        how = typer.Argument(metavar=told.metavar, help=told.help)
    return Parameter(part.name, Parameter.KEYWORD_ONLY, default=default, annotation=Annotated[kind, how])


def _read(part: dataclasses.Field[Any], given: Any, machine: Any) -> object:  # noqa: ANN401 - what is typed
    told: Option = part.metadata["option"]
    if given in (None, "", told.none):
        return part.default
    if told.metavar == A_POSE:
        return parse_pose(given, machine)
    if (form := told.form or told.metavar) in FORMS:
        name, read = max(told.names, key=len), FORMS[form]
        return [read(name, each) for each in given] if told.is_several else read(name, given)
    return SCALES[told.metavar] * given if told.metavar in SCALES else given


def _parameters(takes: Callable[..., Any]) -> list[Parameter]:
    hints = typing.get_type_hints(takes, include_extras=True)
    given = inspect.signature(takes).parameters.values()
    return [each.replace(annotation=hints[each.name], kind=Parameter.KEYWORD_ONLY) for each in given]


def _as_command(command: Command, parameters: Sequence[Parameter], run: Command) -> Command:
    run.__dict__["__signature__"] = inspect.Signature(parameters)
    run.__annotations__ = {each.name: each.annotation for each in parameters}
    run.__name__, run.__doc__ = command.__name__, command.__doc__
    return run

"""Options that several commands take, written once as the fields of a dataclass."""

from __future__ import annotations

import dataclasses
import inspect
import typing
from collections.abc import Callable


def takes(options: type) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorate a command: the parameter annotated with this dataclass becomes one option per field, behind the command's own.

    Parameters
    ----------
    options : type
        A dataclass; each field's annotation and default are those of its option.
    """

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        hints = typing.get_type_hints(command, include_extras=True)
        place = next(name for name, kind in hints.items() if kind is options)
        annotated = typing.get_type_hints(options, include_extras=True)
        own = [
            parameter.replace(annotation=hints[name], kind=inspect.Parameter.KEYWORD_ONLY)
            for name, parameter in inspect.signature(command).parameters.items()
            if name != place
        ]
        parameters = own + [
            inspect.Parameter(
                field.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=inspect.Parameter.empty if field.default is dataclasses.MISSING else field.default,
                annotation=annotated[field.name],
            )
            for field in dataclasses.fields(options)
        ]

        def run(**given: object) -> None:
            shared = options(**{field.name: given.pop(field.name) for field in dataclasses.fields(options)})
            command(**given, **{place: shared})

        run.__dict__["__signature__"] = inspect.Signature(parameters)
        run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        run.__name__, run.__doc__ = command.__name__, command.__doc__
        return run

    return decorate

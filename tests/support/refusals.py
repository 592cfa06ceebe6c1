"""What a call answers, or the message with which it refuses."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

Answer = TypeVar("Answer")


def answer_or_refusal(
    refusal: type[Exception] | tuple[type[Exception], ...], call: Callable[..., Answer], *arguments: object
) -> tuple[Answer, None] | tuple[None, str]:
    """The call's answer and None, or None and the message of its `refusal`; any other exception passes."""
    try:
        return call(*arguments), None
    except refusal as error:
        return None, str(error)

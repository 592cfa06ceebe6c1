"""Who is let in: holders of a one-time token, each of which is exchanged for a session."""

from __future__ import annotations

import hmac
import secrets

from hil.errors import UnusableInputError

SHORTEST_TOKEN = 16
"""Characters of a token: 16 of a random hexadecimal text are 64 bits, which nobody guesses over a network."""
TOKEN_VARIABLE = "ISOCENTER_BENCH_TOKEN"
MOST_INVITATIONS = 8
MOST_SESSIONS = 32


def drawn_token() -> str:
    """Return a token that nobody guesses."""
    return secrets.token_urlsafe(24)


class Admission:
    """Tokens that are still good, and the sessions that were given for others.

    Parameters
    ----------
    token : str
        The first one-time token.

    Raises
    ------
    UnusableInputError
        The token is too short, or has other characters than letters, digits, `-` and `_`.
    """

    def __init__(self, token: str) -> None:
        if len(token) < SHORTEST_TOKEN or not token.replace("-", "").replace("_", "").isalnum() or not token.isascii():
            raise UnusableInputError(
                f"--token: must be at least {SHORTEST_TOKEN} letters, digits, - or _, drawn by chance, such as {secrets.token_hex(8)}"
            )
        self._tokens = [token]
        self._sessions: list[str] = []

    def enter(self, token: str) -> str | None:
        """Exchange a token for a session; None where it is unknown or was used before. Takes as long for any text of one length."""
        good = [each for each in self._tokens if hmac.compare_digest(each.encode(), token.encode())]
        if not good:
            return None
        self._tokens.remove(good[0])
        self._sessions = [*self._sessions[1 - MOST_SESSIONS :], secrets.token_urlsafe(32)]
        return self._sessions[-1]

    def invite(self) -> str:
        """Return a new one-time token, for one more browser; of more than a few the oldest is void."""
        self._tokens = [*self._tokens[1 - MOST_INVITATIONS :], drawn_token()]
        return self._tokens[-1]

    def knows(self, session: str) -> bool:
        """Return whether a session was given."""
        return any([hmac.compare_digest(each.encode(), session.encode()) for each in self._sessions])

"""The one exception that a user is meant to read, and the checks that most configurations need."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from difflib import get_close_matches
from typing import ClassVar


class NerfregError(Exception):
    """Bad input: one line that says what is wrong, where (file, key, value) and what to do.

    Raised at the border, once. The command line prints the line and exits with `exit_code`.
    """

    exit_code: ClassVar[int] = 2


class NoRendererError(NerfregError):
    """A plugin wants rays rendered again where there is no field to render."""


class NonFiniteError(NerfregError):
    """Training met too many losses or gradients in a row that are not finite."""

    exit_code = 3


def require_range(room: str, config: object, **limits: tuple[float | int, float | int]) -> None:
    """Refuse values of `config` outside [lowest, highest], given by key; None passes.

    room: the configuration group, for the message. Raises NerfregError naming key, value and limits.
    """
    for key, (lowest, highest) in limits.items():
        value = getattr(config, key)
        if value is not None and not lowest <= value <= highest:
            limit = (
                f"at least {lowest:g}"
                if highest == float("inf")
                else f"between {lowest:g} and {highest:g}"
            )
            raise NerfregError(f"{room}.{key}={value}: must be {limit}")


def require_choice(room: str, config: object, key: str, choices: Collection[str]) -> None:
    """Refuse a value of `config` that is none of `choices`. Raises NerfregError naming key, value and choices."""
    value = getattr(config, key)
    if value not in choices:
        raise NerfregError(f"{room}.{key}={value}: choose one of {', '.join(choices)}")


def nearest(word: str, known: Iterable[str]) -> str:
    """The end of an error message about an unknown `word`: the nearest known one, or all of them."""
    names = sorted(known)
    close = get_close_matches(word, names, n=1, cutoff=0.5)
    if close:
        return f"did you mean '{close[0]}'?"
    return f"known: {', '.join(names)}" if names else "there is none"

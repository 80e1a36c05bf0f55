"""Errors that a user is meant to read, and the checks that most configurations need."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from difflib import get_close_matches
from typing import ClassVar


class NerfregError(Exception):
    """Bad input, in one line that says what is wrong, where (file, key, value) and what to do.

    Input is checked once, where it enters the program. The command line prints the line and exits
    with `exit_code`.

    Attributes:
        exit_code: Exit code of the command line.
    """

    exit_code: ClassVar[int] = 2


class NerfregWarning(UserWarning):
    """Something that a run does without; the command line shows it in one line."""


class NoRendererError(NerfregError):
    """A plugin wants rays to be rendered again where there is no field to render."""


class NonFiniteError(NerfregError):
    """Training met too many losses or gradients in a row that are not finite."""

    # A code of its own, by which a script can tell a diverged run from a mistake in the input.
    exit_code = 3


class PluginError(NerfregError):
    """A plugin raised something in one of its hooks or modules, or returned what it must not."""

    # A code of its own, by which a script can tell a fault of a plugin from a mistake in the input.
    exit_code = 4


def require_range(group: str, config: object, **limits: tuple[float | int, float | int]) -> None:
    """Refuse values of a configuration that are out of range; None passes.

    Args:
        group: Configuration group, for the message.
        config: The configuration.
        limits: Lowest and highest value by key, both included.

    Raises:
        NerfregError: A value is out of range; names key, value and limits.
    """
    for key, (lowest, highest) in limits.items():
        value = getattr(config, key)
        # Written so that NaN, which compares as false with everything, is refused.
        if value is not None and not lowest <= value <= highest:
            limit = (
                f"at least {lowest:g}"
                if highest == float("inf")
                else f"between {lowest:g} and {highest:g}"
            )
            raise NerfregError(f"{group}.{key}={value}: must be {limit}")


def require_choice(group: str, config: object, key: str, choices: Collection[str]) -> None:
    """Refuse a value of a configuration that is not one of some choices.

    Args:
        group: Configuration group, for the message.
        config: The configuration.
        key: Name of the value.
        choices: What it may be.

    Raises:
        NerfregError: It is something else; names key, value and choices.
    """
    value = getattr(config, key)
    if value not in choices:
        raise NerfregError(f"{group}.{key}={value}: choose one of {', '.join(choices)}")


def nearest(word: str, known: Iterable[str]) -> str:
    """Return the end of an error message about an unknown word.

    Args:
        word: The unknown word.
        known: The words that are known.

    Returns:
        A suggestion of the known word nearest to it; all known words if none is near.
    """
    # Sorted, so that the message does not depend on the order of a set.
    names = sorted(known)
    # Half of the letters in common are enough for a suggestion, which may be wrong at no cost.
    close = get_close_matches(word, names, n=1, cutoff=0.5)
    if close:
        return f"did you mean '{close[0]}'?"
    return f"known: {', '.join(names)}" if names else "there are none"

"""An argument parser whose errors are one line that says what to do, and the types of options."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any, NoReturn

from nerfreg.errors import NerfregError, nearest


class Parser(argparse.ArgumentParser):
    """Raises NerfregError where argparse would print its usage and exit."""

    def __init__(self, **settings: Any) -> None:
        usual = {
            "allow_abbrev": False,
            "formatter_class": argparse.RawDescriptionHelpFormatter,
        }
        super().__init__(**{**usual, **settings})

    @property
    def verb(self) -> str:
        """The words that select this parser, such as `bench step`."""
        return self.prog.partition(" ")[2]

    def read(self, words: Sequence[str]) -> argparse.Namespace:
        """Return the values of options and arguments, which may stand in any order.

        Raises:
            NerfregError: A word is not understood, naming it.
        """
        options, rest = self.parse_known_intermixed_args([*words])
        for word in rest:
            if word.startswith("-"):
                hint = nearest(word, self._option_string_actions)
                raise NerfregError(f"{self.verb}: unknown option '{word}'; {hint}")
            raise NerfregError(f"{self.verb} takes no further argument, got '{word}'")
        return options

    def error(self, message: str) -> NoReturn:
        """Reword argparse's message.

        Raises:
            NerfregError: Always.
        """
        if missing := re.match(r"the following arguments are required: (.*)", message):
            wanted = next(a for a in self._actions if str(a.metavar) == missing[1].split(", ")[0])
            usage = self.format_usage().removeprefix("usage: ").strip()
            raise NerfregError(f"{self.verb} needs {wanted.help}: {' '.join(usage.split())}")
        if named := re.match(r"argument ([^:]+): (.*)", message, re.DOTALL):
            option = named[1].split("/")[0]
            if named[2].startswith("expected"):
                action = self._option_string_actions[option]
                raise NerfregError(
                    f"{option} needs a value: {option} {action.metavar}, {action.help}"
                )
            raise NerfregError(f"{option} {named[2]}")
        raise NerfregError(f"{self.verb}: {message}")


def count(word: str) -> int:
    """Read a whole number, at least 1."""
    if not word.isdecimal() or int(word) == 0:
        raise argparse.ArgumentTypeError(f"{word}: must be a whole number, at least 1")
    return int(word)


def positive(word: str) -> float:
    """Read a positive, finite number."""
    value = _number(word)
    if not value > 0:
        raise argparse.ArgumentTypeError(f"{word}: must be a positive number")
    return value


def share(word: str) -> float:
    """Read a share of the budget, from 0 to 1."""
    value = _number(word)
    if not 0 <= value <= 1:
        raise argparse.ArgumentTypeError(f"{word}: must be a share of the budget, 0 to 1")
    return value


def decibels(word: str) -> float:
    """Read a finite number of decibels."""
    value = _number(word)
    if math.isnan(value):
        raise argparse.ArgumentTypeError(f"{word}: must be a number of decibels, e.g. --psnr 25")
    return value


def names(word: str) -> tuple[str, ...]:
    """Read names that are separated by commas."""
    return tuple(name for name in word.split(",") if name)


def folder(word: str) -> Path:
    """Read a folder to write to, which need not exist."""
    path = Path(word)
    if path.exists() and not path.is_dir():
        raise argparse.ArgumentTypeError(f"{word}: is a file; name a folder")
    return path


def one_of(choices: Collection[str]) -> Callable[[str], str]:
    """Return a reader of one of `choices`, which suggests the nearest for any other word."""

    def read(word: str) -> str:
        if word not in choices:
            raise argparse.ArgumentTypeError(f"{word}: {nearest(word, choices)}")
        return word

    return read


def _number(word: str) -> float:
    """A finite number, or nan."""
    try:
        value = float(word)
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan

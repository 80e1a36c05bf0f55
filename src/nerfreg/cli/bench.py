"""`nerfreg bench NAME [words] [-o FOLDER] [--quick] [options]`."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, cast

from nerfreg.errors import NerfregError, nearest

if TYPE_CHECKING:
    from nerfreg.analysis.tables import Outcome

OVERRIDES, RUN = "[overrides]", "RUN"
"""What a bench may be given beside options: Hydra's overrides, or the folder of a run."""


@dataclass(frozen=True)
class Entry:
    """module: offers what `Bench` asks for; imported when it is run. takes: OVERRIDES, RUN or nothing.
    options: those of its own, each a field of its sizes."""

    module: str
    takes: str = ""
    options: tuple[str, ...] = ()


BENCHES = {
    "quadrature": Entry("nerfreg.bench.quadrature"),
    "losses": Entry("nerfreg.bench.losses"),
    "step": Entry("nerfreg.bench.step", OVERRIDES, ("--steps", "--warmup", "--at")),
    "overhead": Entry("nerfreg.bench.overhead", OVERRIDES, ("--steps", "--only")),
    "render": Entry("nerfreg.bench.render", RUN, ("--views",)),
    "scaling": Entry("nerfreg.bench.scaling", OVERRIDES, ("--steps",)),
}
OPTIONS = ("-o", "--quick")
"""Every bench has these."""


class Bench(Protocol):
    """A bench measures at the sizes given (and, if it takes any, what `words` name), and prints a table."""

    FULL: Any
    QUICK: Any

    def run(self, folder: Path, sizes: Any, *words: tuple[str, ...]) -> Outcome: ...


@dataclass(frozen=True)
class BenchOptions:
    """name: of the bench. folder: where its files go. quick: at the bench's small sizes. words: overrides, or a run.
    sizes: fields of the bench's sizes that are chosen by options."""

    name: str
    folder: Path
    quick: bool
    words: tuple[str, ...]
    sizes: dict[str, Any]


def run(words: list[str]) -> int:
    """Run one bench; returns the exit code. Raises NerfregError for unknown names and options.

    The files that were written are printed, and then the bench's record, if it has one, in one line of JSON.
    """
    options = parse_bench_options(words)
    entry = BENCHES[options.name]
    bench = cast(Bench, import_module(entry.module))
    sizes = replace(bench.QUICK if options.quick else bench.FULL, **options.sizes)
    outcome = bench.run(options.folder, sizes, *([options.words] if entry.takes else []))
    for path in outcome.files:
        print(path)
    if outcome.record is not None:
        print(json.dumps(outcome.record))
    return 0


def parse_bench_options(words: Sequence[str]) -> BenchOptions:
    """Read what follows `nerfreg bench`. Raises NerfregError naming the word at fault."""
    if not words or words[0] in OPTIONS:
        raise NerfregError(f"bench needs a name first; known: {', '.join(BENCHES)}")
    name, *rest = words
    if name not in BENCHES:
        raise NerfregError(f"unknown bench '{name}'; {nearest(name, BENCHES)}")
    entry = BENCHES[name]
    folder, quick, given, sizes = Path("bench", name), False, list[str](), dict[str, Any]()
    while rest:
        word = rest.pop(0)
        if word == "--quick":
            quick = True
        elif word == "-o":
            folder = Path(_value(word, "a folder to write to: -o FOLDER", rest))
        elif word in entry.options:
            wanted, read = READERS[word]
            sizes[word.removeprefix("--")] = read(word, _value(word, f"{wanted}", rest))
        elif entry.takes and not word.startswith("-"):
            given.append(word)
        else:
            raise NerfregError(
                f"bench: unknown option '{word}'; {nearest(word, (*OPTIONS, *entry.options))}"
            )
    if entry.takes == RUN and len(given) != 1:
        raise NerfregError(f"bench {name} needs the folder of one run: nerfreg bench {name} RUN")
    if folder.exists() and not folder.is_dir():
        raise NerfregError(f"-o {folder}: is a file; name a folder")
    return BenchOptions(name, folder, quick, tuple(given), sizes)


def _value(option: str, wanted: str, rest: list[str]) -> str:
    if not rest or rest[0].startswith("-"):
        raise NerfregError(f"{option} needs {wanted}")
    return rest.pop(0)


def _count(option: str, word: str) -> int:
    if not word.isdecimal() or int(word) == 0:
        raise NerfregError(f"{option} {word}: must be a whole number, at least 1")
    return int(word)


def _fraction(option: str, word: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = -1.0
    if not 0 <= value <= 1:
        raise NerfregError(f"{option} {word}: must be a share of the budget, 0 to 1")
    return value


def _names(option: str, word: str) -> tuple[str, ...]:
    return tuple(name for name in word.split(",") if name)


READERS: dict[str, tuple[str, Callable[[str, str], Any]]] = {
    "--steps": ("the number of steps to time", _count),
    "--warmup": ("the number of steps before those that are timed", _count),
    "--views": ("the number of views to time", _count),
    "--at": ("a share of the budget, 0 to 1", _fraction),
    "--only": ("names of plugins and presets, separated by commas", _names),
}

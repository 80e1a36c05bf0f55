"""`nerfreg bench NAME [-o FOLDER] [--quick]`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol, cast

from nerfreg.errors import NerfregError
from nerfreg.nearest import nearest

BENCHES = {
    "quadrature": "nerfreg.bench.quadrature",
    "losses": "nerfreg.bench.losses",
}
"""Each names a module that offers what `Bench` asks for; it is imported when it is run."""
OPTIONS = ("-o", "--quick")


class Bench(Protocol):
    """A bench measures at the sizes given, prints a table and returns the files it has written."""

    FULL: Any
    QUICK: Any

    def run(self, folder: Path, sizes: Any) -> list[Path]: ...


@dataclass(frozen=True)
class BenchOptions:
    """name: of the bench. folder: where its files go. quick: at the bench's small sizes."""

    name: str
    folder: Path
    quick: bool


def run(words: list[str]) -> int:
    """Run one bench; returns the exit code. Raises NerfregError for unknown names and options."""
    options = parse_bench_options(words)
    bench = cast(Bench, import_module(BENCHES[options.name]))
    for path in bench.run(options.folder, bench.QUICK if options.quick else bench.FULL):
        print(path)
    return 0


def parse_bench_options(words: Sequence[str]) -> BenchOptions:
    """Read what follows `nerfreg bench`. Raises NerfregError naming the word at fault."""
    if not words or words[0] in OPTIONS:
        raise NerfregError(f"bench needs a name first; known: {', '.join(BENCHES)}")
    name, *rest = words
    if name not in BENCHES:
        raise NerfregError(f"unknown bench '{name}'; {nearest(name, BENCHES)}")
    folder, quick = Path("bench", name), False
    while rest:
        word = rest.pop(0)
        if word == "--quick":
            quick = True
        elif word == "-o":
            if not rest or rest[0] in OPTIONS:
                raise NerfregError("-o needs a folder to write to: -o FOLDER")
            folder = Path(rest.pop(0))
        else:
            raise NerfregError(f"bench: unknown option '{word}'; {nearest(word, OPTIONS)}")
    if folder.exists() and not folder.is_dir():
        raise NerfregError(f"-o {folder}: is a file; name a folder")
    return BenchOptions(name, folder, quick)

"""Files that are whole or not there at all, and the one way in which JSON and CSV are written."""

from __future__ import annotations

import csv
import json
import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from nerfreg.errors import NerfregError


@contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """Yield a path to write to that becomes `path` when the block succeeds.

    It lies in the same folder, which is made if need be, and has the same suffix. If the block
    fails, what was written is removed and an old `path` stays as it was.

    Raises:
        NerfregError: The file cannot be written.
    """
    # The process number keeps two processes that write the same file from sharing one part.
    part = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield part
        part.replace(path)
    except OSError as error:
        raise _unwritable(path, error) from error
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def json_text(value: Any, indent: int | None = None) -> str:
    """Return strict JSON, which has neither nan nor infinities: they become null, as None does."""
    return json.dumps(_finite(value), allow_nan=False, indent=indent)


def write_text(path: Path, text: str) -> None:
    """Write a text file, whole or not at all.

    Raises:
        NerfregError: The file cannot be written.
    """
    with atomic(path) as part:
        part.write_text(text, encoding="utf-8", newline="\n")


def write_json(path: Path, value: Any) -> None:
    """Write a value as indented strict JSON, whole or not at all.

    Raises:
        NerfregError: The file cannot be written.
    """
    write_text(path, json_text(value, indent=2) + "\n")


def append_json_line(path: Path, value: Any) -> None:
    """Add one line of strict JSON; it is on its way to the disk when this returns.

    Raises:
        NerfregError: The file cannot be written.
    """
    line = json_text(value) + "\n"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a", encoding="utf-8") as file:
            file.write(line)
    except OSError as error:
        raise _unwritable(path, error) from error


def write_csv(path: Path, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a CSV file with a line of column names, whole or not at all.

    Raises:
        NerfregError: The file cannot be written.
    """
    with atomic(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(rows)


def _unwritable(path: Path, error: OSError) -> NerfregError:
    return NerfregError(f"{path}: cannot be written ({error.strerror or error})")


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value

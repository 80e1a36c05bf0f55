"""Files that are whole or not there at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from nerfreg.errors import NerfregError


@contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """A path to write to, in the same folder and with the same suffix, that becomes `path` when the block succeeds.

    The folder is made if need be. If the block fails, what was written is removed and an old `path` stays as it was.
    Raises NerfregError where the file cannot be written.
    """
    part = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield part
        part.replace(path)
    except OSError as error:
        raise NerfregError(f"{path}: cannot be written ({error.strerror or error})") from error
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)

"""Weights on disk: safetensors for tensors, JSON for the rest, nothing that could run code."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from safetensors import SafetensorError
from safetensors.torch import load_file, save_file

from nerfreg.errors import NerfregError
from nerfreg.field import RadianceField

FOLDER = "checkpoint"
WEIGHTS = "field.safetensors"
STATE = "state.json"


@dataclass(frozen=True)
class State:
    """Where a run stood when its weights were saved.

    points: evaluations of the density in training so far. skipped_steps: steps left out, see `Guard`.
    """

    step: int
    train_seconds: float
    points: int
    skipped_steps: int = 0


def save_checkpoint(run: Path, field: RadianceField, state: State) -> None:
    """Write RUN/checkpoint; an older one is replaced file by file, each whole or not at all."""
    folder = run / FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    weights = {
        name: tensor.detach().cpu().contiguous() for name, tensor in field.state_dict().items()
    }
    save_file(weights, folder / f".{WEIGHTS}")
    (folder / f".{STATE}").write_text(json.dumps(asdict(state), indent=2) + "\n", encoding="utf-8")
    for name in (WEIGHTS, STATE):
        (folder / f".{name}").replace(folder / name)


def load_checkpoint(run: Path, field: RadianceField) -> State:
    """Read RUN/checkpoint into a field of the same shape. Raises NerfregError where that cannot be."""
    path = run / FOLDER / WEIGHTS
    try:
        field.load_state_dict(load_file(path))
        return State(**json.loads((run / FOLDER / STATE).read_text(encoding="utf-8")))
    except FileNotFoundError as error:
        raise NerfregError(
            f"{error.filename or path}: missing; has the run been trained to its end?"
        ) from error
    except (SafetensorError, RuntimeError, ValueError, TypeError) as error:
        raise NerfregError(
            f"{path}: does not fit the run's configuration: {str(error).splitlines()[0]}"
        ) from error

"""Weights on disk: safetensors for tensors, JSON for the rest, nothing that could run code."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from safetensors import SafetensorError
from safetensors.torch import load_file, save_file

from nerfreg.errors import NerfregError
from nerfreg.field import RadianceField
from nerfreg.files import json_text, write_text

FOLDER = "checkpoint"
WEIGHTS = "field.safetensors"
STATE = "state.json"


@dataclass(frozen=True)
class State:
    """Where a run stood when its weights were saved.

    Attributes:
        step: Number of steps done.
        train_seconds: Training time, in seconds.
        points: Evaluations of the density in training.
        skipped_steps: Steps that were left out; see `nerfreg.training.guard.Guard`.
    """

    step: int
    train_seconds: float
    points: int
    skipped_steps: int = 0


def save_checkpoint(run: Path, field: RadianceField, state: State) -> None:
    """Write RUN/checkpoint; an older one is replaced file by file, each whole or not at all.

    Args:
        run: The run's folder.
        field: Its field, with the weights to save.
        state: Where the run stands.
    """
    folder = run / FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    weights = {
        name: tensor.detach().cpu().contiguous() for name, tensor in field.state_dict().items()
    }
    # Both files are written in full before either is renamed: a failure while they are written, of
    # a full disk for example, leaves the old pair, and old and new files are mixed only if the
    # process ends between the two renamings.
    save_file(weights, folder / f".{WEIGHTS}")
    write_text(folder / f".{STATE}", json_text(asdict(state), indent=2) + "\n")
    for name in (WEIGHTS, STATE):
        (folder / f".{name}").replace(folder / name)


def load_checkpoint(run: Path, field: RadianceField) -> State:
    """Read RUN/checkpoint into a field.

    Args:
        run: The run's folder.
        field: A field of the run's configuration, whose weights are replaced.

    Returns:
        Where the run stood.

    Raises:
        NerfregError: The checkpoint is missing or damaged, or belongs to another configuration.
    """
    path = run / FOLDER / WEIGHTS
    try:
        field.load_state_dict(load_file(path))
        return State(**json.loads((run / FOLDER / STATE).read_text(encoding="utf-8")))
    except FileNotFoundError as error:
        raise NerfregError(
            f"{error.filename or path}: missing; has the run been trained to its end?"
        ) from error
    except (SafetensorError, RuntimeError, ValueError, TypeError) as error:
        # PyTorch lists every mismatch on a line of its own; the first says enough.
        raise NerfregError(
            f"{path}: does not fit the run's configuration: {str(error).splitlines()[0]}"
        ) from error

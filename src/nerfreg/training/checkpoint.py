"""Weights on disk: safetensors for tensors, JSON for the rest, nothing that could run code."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from safetensors import SafetensorError
from safetensors.torch import load_file, save_file

from nerfreg.errors import NerfregError
from nerfreg.field import RadianceField
from nerfreg.files import json_text, write_text
from nerfreg.training.plugin_state import packed, unpacked

FOLDER = "checkpoint"
WEIGHTS = "field.safetensors"
PLUGINS = "plugins.safetensors"
STATE = "state.json"


@dataclass(frozen=True)
class State:
    """Where a run stood when its weights were saved.

    Attributes:
        step: Number of steps done.
        train_seconds: Training time, in seconds.
        points: Evaluations of the density in training.
        skipped_steps: Steps that were left out; see `nerfreg.training.guard.Guard`.
        fraction: Share of the budget that was spent.
        plugins: What plugins had learned besides parameters, by name (`Regularizer.state_dict`).
    """

    step: int
    train_seconds: float
    points: int
    skipped_steps: int = 0
    fraction: float = 1.0
    plugins: dict[str, dict[str, Any]] = field(default_factory=dict)

    def record(self) -> dict[str, int | float]:
        """Return what results and metrics tell of it."""
        names = ("step", "train_seconds", "points", "skipped_steps")
        return {name: getattr(self, name) for name in names}


def save_checkpoint(run: Path, radiance: RadianceField, state: State) -> None:
    """Write RUN/checkpoint; an older one is replaced file by file, each whole or not at all.

    Args:
        run: The run's folder.
        radiance: Its field, with the weights to save.
        state: Where the run stands.
    """
    folder = run / FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    weights = {
        name: tensor.detach().cpu().contiguous() for name, tensor in radiance.state_dict().items()
    }
    # All files are written in full before either is renamed: a failure while they are written, of
    # a full disk for example, leaves the old ones, and old and new files are mixed only if
    # the process ends between two renamings.
    save_file(weights, folder / f".{WEIGHTS}")
    plain, tensors = packed(state.plugins)
    if tensors:
        save_file(tensors, folder / f".{PLUGINS}")
    else:
        (folder / PLUGINS).unlink(missing_ok=True)
    record = {**vars(state), "plugins": plain}
    write_text(folder / f".{STATE}", json_text(record, indent=2) + "\n")
    for name in (WEIGHTS, *([PLUGINS] if tensors else []), STATE):
        (folder / f".{name}").replace(folder / name)


def load_checkpoint(run: Path, radiance: RadianceField) -> State:
    """Read RUN/checkpoint into a field.

    Args:
        run: The run's folder.
        radiance: A field of the run's configuration, whose weights are replaced.

    Returns:
        Where the run stood.

    Raises:
        NerfregError: The checkpoint is missing or damaged, or belongs to another configuration.
    """
    path = run / FOLDER / WEIGHTS
    try:
        radiance.load_state_dict(load_file(path))
        record = json.loads((run / FOLDER / STATE).read_text(encoding="utf-8"))
        of_plugins = run / FOLDER / PLUGINS
        tensors = load_file(of_plugins) if of_plugins.is_file() else {}
        return State(**{**record, "plugins": unpacked(record.get("plugins", {}), tensors)})
    except FileNotFoundError as error:
        raise NerfregError(
            f"{error.filename or path}: missing; has the run been trained to its end?"
        ) from error
    except (SafetensorError, RuntimeError, ValueError, TypeError) as error:
        # PyTorch lists every mismatch on a line of its own; the first says enough.
        raise NerfregError(
            f"{path}: does not fit the run's configuration: {str(error).splitlines()[0]}"
        ) from error

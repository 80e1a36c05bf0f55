"""The file of a step that training left out because its loss or a gradient was not finite.

A safetensors file with the rays, the weights and the state of the random generator; its metadata
hold the configuration, the position in the run and what was not finite. It is all that is needed to
render the step again (`nerfreg.runs.replay`), without the scene and the folder of the run.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from omegaconf import DictConfig, OmegaConf
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from nerfreg.config.saved import as_yaml, restored
from nerfreg.config.schema import Config
from nerfreg.errors import NerfregError
from nerfreg.field import RadianceField
from nerfreg.files import atomic, json_text
from nerfreg.hooks import Rays, Step
from nerfreg.rays.batch import Batch
from nerfreg.runs.files import RECORDED_STEPS
from nerfreg.scenes.cameras import Cameras
from nerfreg.scenes.layouts import OBJECT, ORBIT, ROOM
from nerfreg.scenes.scene import SceneInfo
from nerfreg.training.faults import Fault
from nerfreg.training.plugin_state import packed, unpacked

FORMAT = "nerfreg-step-1"
"""Name and version of the format, in the metadata."""
CAMERAS = ("poses", "focal", "center", "distortion")
SCENE = ("near", "far", "layout", "name", "labels")
"""What is recorded of the scene besides its box and the training cameras."""
KEPT = 3
"""Number of files that a run keeps: as many as the steps in a row that end a run."""


@dataclass(frozen=True)
class Recording:
    """A step that training left out.

    Attributes:
        config: Configuration of the run.
        batch: The rays of the step, without a renderer.
        weights: Weights of the field before the step, by name.
        scene: What was known of the scene.
        faults: What was not finite.
        states: The state of plugins, by name.
    """

    config: Config
    batch: Batch
    weights: dict[str, Tensor]
    scene: SceneInfo
    faults: tuple[str, ...]
    states: dict[str, dict[str, Any]]


class StepRecorder:
    """Saves steps of a run in RUN/nonfinite, each whole or not at all, and keeps the latest."""

    def __init__(self, run: Path, config: Config) -> None:
        """Remove the steps of earlier runs in the same folder.

        Args:
            run: The run's folder.
            config: Its configuration.
        """
        self._folder = run / RECORDED_STEPS
        self._config = config
        self._drop_all_but(0)

    def save(
        self,
        batch: Batch,
        field: RadianceField,
        box: Float[Tensor, "2 3"],
        faults: Sequence[Fault],
        states: dict[str, dict[str, Any]],
    ) -> Path:
        """Save one step.

        Args:
            batch: The rays of the step.
            field: The field, with its weights before the step.
            box: (2, 3) corners of the scene's box.
            faults: What was not finite.
            states: The state of plugins, by name.

        Returns:
            The file.

        Raises:
            NerfregError: The file cannot be written.
        """
        # Zeros make the order of names that of steps, by which the latest are kept.
        path = self._folder / f"step_{batch.step.index:06d}.safetensors"
        _write(path, self._config, batch, field.state_dict(), box, faults, states)
        self._drop_all_but(KEPT)
        return path

    def _drop_all_but(self, count: int) -> None:
        saved = sorted(self._folder.glob("step_*.safetensors"))
        for path in saved[: max(len(saved) - count, 0)]:
            path.unlink()


def _write(
    path: Path,
    config: Config,
    batch: Batch,
    weights: dict[str, Tensor],
    box: Tensor,
    faults: Sequence[Fault],
    states: dict[str, dict[str, Any]],
) -> None:
    rays = {
        f"rays.{name}": part for name, part in vars(batch.rays).items() if isinstance(part, Tensor)
    } | {f"rays.data.{name}": values for name, values in batch.rays.data.items()}
    scene = batch.step.scene
    assert scene is not None, "a step of training has a scene"
    plain, of_plugins = packed(states)
    tensors = {**rays, **{f"field.{name}": tensor for name, tensor in weights.items()}}
    # In format 1 the state of the generator has this name.
    tensors |= {"box": box, "chance": batch.rng_state}
    tensors |= {f"cameras.{name}": getattr(scene.cameras, name) for name in CAMERAS}
    tensors |= {f"plugins.{name}": part for name, part in of_plugins.items()}
    step = {key: getattr(batch.step, key) for key in ("index", "total", "fraction", "bounds")}
    metadata = {
        "format": FORMAT,
        "config": as_yaml(config),
        "step": json.dumps(step),
        "faults": json.dumps([fault.what for fault in faults]),
        "scene": json.dumps(
            {
                "size": [scene.cameras.width, scene.cameras.height],
                **{name: getattr(scene, name) for name in SCENE},
            }
        ),
        "plugins": json_text(plain),
    }
    # Cloned, because rays may share memory with one another, which safetensors refuses.
    whole = {
        name: tensor.detach().cpu().clone(memory_format=torch.contiguous_format)
        for name, tensor in tensors.items()
    }
    with atomic(path) as part:
        save_file(whole, part, metadata)


def load_recording(path: Path) -> Recording:
    """Read the file of a step.

    Raises:
        NerfregError: The file is missing, damaged or of another kind, or plugins of its run are not
            installed.
    """
    if not path.is_file():
        raise NerfregError(
            f"{path}: no such file; training saves the steps that it leaves out in RUN/nonfinite"
        )
    try:
        with safe_open(path, "pt") as file:
            metadata = file.metadata() or {}
            # `file` is not a dictionary and cannot be iterated over.
            names = file.keys()
            tensors = {name: file.get_tensor(name) for name in names}
    except (SafetensorError, OSError) as error:
        raise NerfregError(f"{path}: cannot be read: {str(error).splitlines()[0]}") from error
    if metadata.get("format") != FORMAT:
        raise NerfregError(f"{path}: not a step saved by training (its format is not '{FORMAT}')")
    saved = OmegaConf.create(metadata["config"])
    assert isinstance(saved, DictConfig)
    step = json.loads(metadata["step"])
    parts: dict[str, Any] = {part.name: tensors.get(f"rays.{part.name}") for part in fields(Rays)}
    parts["data"] = _below(tensors, "rays.data.")
    low, high = step["bounds"]
    known = json.loads(metadata.get("scene", "{}"))
    known.setdefault("layout", OmegaConf.select(saved, "scene.layout") or ORBIT)
    if known["layout"] == ORBIT:
        # Written when objects and rooms were one kind. Rays have a background where there is alpha.
        known["layout"] = ROOM if parts["background"] is None else OBJECT
    scene = _scene(tensors, known, (low, high))
    # Otherwise the scene, which need not be here, would be asked for its kind.
    saved.scene.layout = scene.layout
    generator = torch.Generator()
    generator.set_state(tensors["chance"])
    position = (step["index"], step["total"], step["fraction"])
    return Recording(
        config=restored(saved, str(path)),
        batch=Batch.of(Rays(**parts), Step(*position, generator, (low, high), scene=scene)),
        weights=_below(tensors, "field."),
        scene=scene,
        faults=tuple(json.loads(metadata["faults"])),
        states=unpacked(json.loads(metadata.get("plugins", "{}")), _below(tensors, "plugins.")),
    )


def _below(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {
        name.removeprefix(prefix): part for name, part in tensors.items() if name.startswith(prefix)
    }


def _scene(
    tensors: dict[str, Tensor], known: dict[str, Any], bounds: tuple[float, float]
) -> SceneInfo:
    """The scene of a recording; one without cameras if the recording is older than these."""
    none = {"poses": (0, 3, 4), "focal": (0, 2), "center": (0, 2), "distortion": (0, 5)}
    parts = [tensors.get(f"cameras.{name}", torch.zeros(none[name])) for name in CAMERAS]
    width, height = known.get("size", (1, 1))
    return SceneInfo(
        cameras=Cameras(width, height, *parts),
        box=tensors["box"],
        near=known.get("near", bounds[0]),
        far=known.get("far", bounds[1]),
        layout=known["layout"],
        name=known.get("name", ""),
        labels=tuple(known.get("labels", ())),
    )

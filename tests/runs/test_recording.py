"""A step on disk: rays, weights and RNG state come back, and other files are refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from nerfreg_plugins.lipschitz import Lipschitz
from safetensors import safe_open
from safetensors.torch import save_file

from nerfreg import Schedule, hookimpl
from nerfreg.config.plugin import settings_of
from nerfreg.config.schema import Config
from nerfreg.errors import NerfregError
from nerfreg.registry import Hooks, plugins
from nerfreg.rendering.renderer import Renderer
from nerfreg.runs.recording import StepRecorder, load_recording
from nerfreg.runs.replay import replay
from nerfreg.scenes import Procedural
from nerfreg.training.guard import Guard
from nerfreg.training.loss import loss_terms
from nerfreg.training.trainer import Trainer

pytestmark = pytest.mark.usefixtures("faulty")
PLUGINS = "+reg=[faulty,combinerf,entropy,entropy@faint]"
SCHEDULE = "reg.faint.weight={schedule:linear,from:0,to:1e-3}"


@pytest.fixture
def saved(
    make: Callable[..., Trainer], compose: Callable[..., Config], tmp_path: Path
) -> tuple[Trainer, list, Path]:
    """A trainer, the terms of its step 2, which was left out, and the file of that step."""
    words = (PLUGINS, SCHEDULE, "reg.faulty.steps=[2]", "reg.faulty.way=gradient", "seed=5")
    small = (
        "scene.size=24", "sampler.coarse=16", "sampler.fine=16", "field.levels=4",
        "field.finest=64", "field.log2_entries=12",
    )  # fmt: skip
    config = compose(*small, *words)
    trainer = make(*words, guard=Guard(StepRecorder(tmp_path, config), lambda line: None))
    terms = [trainer.step() for _ in range(3)][-1]
    return trainer, terms, tmp_path / "nonfinite" / "step_000002.safetensors"


def test_the_step_comes_back_to_the_last_bit(
    saved: tuple[Trainer, list, Path], compose: Callable[..., Config]
) -> None:
    trainer, terms, path = saved
    recording = load_recording(path)
    assert recording.faults == ("gradient of faulty",)
    position = recording.batch.step
    assert (position.index, position.total, position.fraction) == (2, 40, 2 / 40)
    assert position.bounds == (trainer.scene.near, trainer.scene.far)
    for name, weights in trainer.field.state_dict().items():
        assert torch.equal(recording.weights[name], weights)
    hooks = Hooks(recording.config.reg)
    batch = recording.batch.again(Renderer(trainer.field, recording.config.sampler, hooks))
    hooks.begin(batch.step)
    again = loss_terms(batch.render(), hooks, batch.step)
    assert [term.weight for term in again] == [term.weight for term in terms]
    assert [term.plugin for term in again] == [term.plugin for term in terms]
    assert len(terms) > 5 and all(
        torch.equal(a.value, b.value) for a, b in zip(again, terms, strict=True)
    )


def test_the_configuration_comes_back_with_its_types(saved: tuple[Trainer, list, Path]) -> None:
    config = load_recording(saved[2]).config
    plugins = saved[0].hooks.plugins
    assert {name: type(plugin) for name, plugin in config.reg.items()} == {
        n: type(p) for n, p in plugins.items()
    }
    assert {name: settings_of(plugin) for name, plugin in config.reg.items()} == {
        n: settings_of(p) for n, p in plugins.items()
    }
    assert config.seed == 5
    assert config.reg["faint"].schedules == {"weight": Schedule("linear", 0.0, 1e-3)}


@pytest.mark.parametrize("written", [True, False])
@pytest.mark.parametrize(("opaque", "kind"), [(False, "object"), (True, "room")])
def test_a_step_of_earlier_versions_needs_no_scene(
    saved: tuple[Trainer, list, Path],
    monkeypatch: pytest.MonkeyPatch,
    written: bool,
    opaque: bool,
    kind: str,
) -> None:
    path = saved[2]
    with safe_open(path, "pt") as file:
        metadata = file.metadata()
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    assert "layout: object" in metadata["config"]
    metadata["config"] = metadata["config"].replace("layout: object", "layout: orbit")
    scene = json.loads(metadata["scene"])
    assert scene.pop("layout") == "object"
    metadata["scene"] = json.dumps(scene | ({"layout": "orbit"} if written else {}))
    if opaque:
        del tensors["rays.background"]
    save_file(tensors, path, metadata)
    monkeypatch.setattr(Procedural, "load", lambda self: pytest.fail("the scene was asked for"))
    recording = load_recording(path)
    assert (recording.scene.layout, recording.config.scene.layout) == (kind, kind)


def test_nothing_else_is_left_in_the_folder(saved: tuple[Trainer, list, Path]) -> None:
    assert list(saved[2].parent.iterdir()) == [saved[2]]


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(NerfregError, match=r"step_1\.safetensors: no such file"):
        replay(tmp_path / "step_1.safetensors")


def test_a_damaged_file(tmp_path: Path) -> None:
    path = tmp_path / "step.safetensors"
    path.write_bytes(b"nothing")
    with pytest.raises(NerfregError, match=r"step\.safetensors: cannot be read"):
        replay(path)


def test_weights_are_no_step(tmp_path: Path) -> None:
    path = tmp_path / "field.safetensors"
    save_file({"grid.table": torch.zeros(2)}, path)
    with pytest.raises(NerfregError, match="not a step saved by training"):
        replay(path)


def test_a_plugin_that_is_not_installed_here(
    saved: tuple[Trainer, list, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    points = [point for point in plugins._entry_points() if point.name != "faulty"]
    monkeypatch.setattr(plugins, "_entry_points", lambda: points)
    with pytest.raises(NerfregError, match=r"reg\.faulty is not installed here"):
        replay(saved[2])


def test_a_plugin_whose_layers_have_changed(
    saved: tuple[Trainer, list, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Lipschitz, "nerfreg_layer", hookimpl(lambda self: None))
    with pytest.raises(
        NerfregError, match="its weights do not fit the plugins that are installed now"
    ):
        replay(saved[2])

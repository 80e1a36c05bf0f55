"""Checkpoints."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from nerfreg.errors import NerfregError
from nerfreg.field import FieldConfig, RadianceField
from nerfreg.registry import Hooks
from nerfreg.training.checkpoint import State, load_checkpoint, save_checkpoint


def make(hidden: int = 8) -> RadianceField:
    config = FieldConfig(levels=2, base=4, finest=8, log2_entries=8, hidden=hidden)
    return RadianceField(config, torch.tensor([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]), Hooks().layer)


def test_what_is_saved_is_loaded_and_nothing_else_is_left(tmp_path: Path) -> None:
    saved, loaded = make(), make()
    save_checkpoint(tmp_path, saved, State(7, 1.5, 100))
    assert load_checkpoint(tmp_path, loaded) == State(7, 1.5, 100)
    for a, b in zip(saved.parameters(), loaded.parameters(), strict=True):
        assert torch.equal(a, b)
    assert sorted(path.name for path in (tmp_path / "checkpoint").iterdir()) == [
        "field.safetensors",
        "state.json",
    ]


def test_a_missing_checkpoint_says_so(tmp_path: Path) -> None:
    with pytest.raises(NerfregError, match="missing; has the run been trained to its end"):
        load_checkpoint(tmp_path, make())


def test_a_checkpoint_of_another_shape_is_refused(tmp_path: Path) -> None:
    save_checkpoint(tmp_path, make(), State(1, 1.0, 1))
    with pytest.raises(NerfregError, match="does not fit the run's configuration"):
        load_checkpoint(tmp_path, make(hidden=16))


def test_a_damaged_checkpoint_is_refused(tmp_path: Path) -> None:
    save_checkpoint(tmp_path, make(), State(1, 1.0, 1))
    (tmp_path / "checkpoint" / "field.safetensors").write_bytes(b"nothing")
    with pytest.raises(NerfregError, match=r"field\.safetensors"):
        load_checkpoint(tmp_path, make())

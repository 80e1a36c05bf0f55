"""What the photographs of a scene cannot fill is left out of its grid."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from nerfreg.field import FieldConfig
from nerfreg.field.fit import fitted
from nerfreg.scenes import Scene
from nerfreg.scenes.cameras import Cameras

PAPER = FieldConfig(
    levels=8, base=16, finest=2048, log2_entries=19, fit=True
)  # each level has twice the cells of the one before


def a_scene(near: float = 2.0, focal: float = 100.0, size: int = 64) -> Scene:
    """A box of 4 and two training views of `size` squared pixels.

    The third view, a test view, is ten times as sharp.
    """
    cameras = Cameras(
        size,
        size,
        torch.eye(3, 4).repeat(3, 1, 1),
        torch.tensor([[focal, focal / 2], [focal / 2, focal / 2], [10 * focal, 10 * focal]]),
        torch.full((3, 2), size / 2),
        torch.zeros(3, 5),
    )
    box = torch.tensor([[-2.0, -1.0, -2.0], [2.0, 1.0, 2.0]])
    return Scene(
        "",
        "object",
        cameras,
        (0, 1),
        (2,),
        box,
        near,
        8.0,
        lambda view: torch.zeros(0),
        False,
        None,
    )


@pytest.mark.parametrize(
    ("near", "levels", "finest"),
    [
        # A pixel at distance 2 is 2 / 100 wide; 4 / 128 = 0.031 is not smaller, 4 / 256 = 0.016 is.
        (2.0, 4, 128),
        # 1.5625 / 100 = 4 / 256 exactly: a cell as large as a pixel stays.
        (1.5625, 5, 256),
        (0.1, 8, 2048),
        # One level is left however coarse the pixels are.
        (100.0, 1, 16),
    ],
)
def test_levels_finer_than_the_finest_pixel_footprint_go(
    near: float, levels: int, finest: int
) -> None:
    config = fitted(PAPER, a_scene(near))
    assert (config.levels, config.base, config.finest) == (levels, 16, finest)
    assert fitted(config, a_scene(near)) == config


def test_a_level_has_no_more_entries_than_there_are_training_pixels() -> None:
    # 2 x 64 x 64 = 2^13; 2 x 65 x 65 = 8450 needs 2^14; 2 x 1024 x 1024 is more than 2^19.
    assert fitted(PAPER, a_scene()).log2_entries == 13
    assert fitted(PAPER, a_scene(size=65)).log2_entries == 14
    assert fitted(PAPER, a_scene(size=1024)).log2_entries == 19
    assert fitted(PAPER, a_scene(size=1)).log2_entries == 3


def test_nothing_goes_unless_asked_for() -> None:
    whole = replace(PAPER, fit=False)
    assert fitted(whole, a_scene()) == whole

"""The package depth_ranks: rendered depths come into the order of monocular maps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest
import torch
from torch import Tensor

from nerfreg import Needs, NerfregError
from nerfreg.registry import Hooks
from nerfreg.scenes import load_scene
from nerfreg.scenes.scene import Photographs, Scene
from nerfreg.training.trainer import Trainer

pytestmark = pytest.mark.usefixtures("gallery")
LEVELS = 64


def levels(scene: Scene, view: int) -> Tensor:
    """True depth, coarsened to whole numbers, the background farthest."""
    assert scene.read_depth is not None
    depth = scene.read_depth(view).clamp(scene.near, scene.far)
    share = (depth - scene.near) / (scene.far - scene.near)
    return (share * LEVELS).round()


def write_maps(
    scene: Scene, folder: Path, curve: Callable[[Tensor], Tensor], scale: int = 1
) -> str:
    """Write a map for each training view, and return how the plugin is told."""
    folder.mkdir()
    for view in scene.train:
        values = (65535 * curve(levels(scene, view) / LEVELS)).round().numpy().astype(np.uint16)
        name = f"{Path(scene.labels[view]).stem}_depth.png"
        iio.imwrite(folder / name, values.repeat(scale, axis=0).repeat(scale, axis=1))
    return f"reg.depth_ranks.maps={folder}"


def agreement(trainer: Trainer) -> float:
    """Share of random pairs of pixels of one view whose rendered depths are in the true order."""
    torch.manual_seed(0)
    trainer.batches.count = 1024
    rays = trainer.batches.draw(Needs())
    with torch.no_grad():
        depth = trainer.renderer.render(rays, trainer._step()).depth
    x, y = (rays.pixel - 0.5).long().unbind(-1)
    maps = torch.stack([levels(trainer.scene, view) for view in trainer.scene.train])
    true = maps[rays.view, y, x]
    a, b = torch.randint(len(rays), (2, 20000))
    told = (rays.view[a] == rays.view[b]) & ((true[a] - true[b]).abs() > 1)
    assert int(told.sum()) > 1000
    right = (depth[a] - depth[b]).sign() == (true[a] - true[b]).sign()
    return float(right[told].float().mean())


@pytest.fixture
def scene(compose) -> Scene:
    return load_scene(compose("scene.size=24", "scene.views=3", "scene.test_views=1").scene)


def test_any_monotone_maps_order_the_depths(make, scene: Scene, tmp_path: Path) -> None:
    vanilla = make()
    cubes = write_maps(scene, tmp_path / "cubes", lambda share: share**3)
    # Close is large, as in the maps of networks that estimate disparity.
    closeness = write_maps(scene, tmp_path / "closeness", lambda share: 1 / (1 + share) - 0.5)
    own = ["+reg=depth_ranks", "reg.depth_ranks.weight=1"]
    trained = [
        make(*own, cubes),
        make(*own, closeness, "reg.depth_ranks.disparity=true"),
    ]
    for trainer in (vanilla, *trained):
        for _ in range(25):
            trainer.step()
    # Nothing but the order counts: both curves train the same weights.
    assert torch.equal(trained[0].field.grid.table, trained[1].field.grid.table)
    before, after = agreement(vanilla), agreement(trained[0])
    assert 1 - after < 0.7 * (1 - before)


def test_wrong_order_costs_its_depth_and_right_order_nothing(
    make, scene: Scene, tmp_path: Path
) -> None:
    maps = write_maps(scene, tmp_path / "maps", lambda share: share)
    trainer = make("+reg=depth_ranks", maps)
    step = trainer._step()
    rays = trainer.batches.draw(Needs())
    rendering = trainer.renderer.render(rays, step)
    near, far = step.bounds
    true = rays.data["depth_ranks.depth"]
    [right] = trainer.hooks.losses(replace(rendering, depth=near + (far - near) * true), step)
    [wrong] = trainer.hooks.losses(replace(rendering, depth=far - (far - near) * true), step)
    [flat] = trainer.hooks.losses(replace(rendering, depth=torch.ones_like(true)), step)
    assert float(right.value) == 0
    assert 0 < float(flat.value) <= 1.01e-4
    assert float(wrong.value) > 0.01


def test_map_of_another_size_is_brought_to_that_of_the_image(scene: Scene, tmp_path: Path) -> None:
    small = prepared(scene.photographs(), write_maps(scene, tmp_path / "same", torch.square))
    large = prepared(scene.photographs(), write_maps(scene, tmp_path / "twice", torch.square, 2))
    assert torch.equal(small, large)
    assert small.shape == (3, 24, 24) and small.isfinite().all()


def test_padding_of_an_image_has_no_depth(scene: Scene, tmp_path: Path) -> None:
    photographs = scene.photographs()
    valid = torch.ones(3, 24, 24, dtype=torch.bool)
    valid[1, 20:] = False
    valid[1, :, 12:] = False
    maps = write_maps(scene, tmp_path / "maps", torch.square)
    whole = prepared(photographs, maps)
    file = tmp_path / "maps" / "1_depth.png"
    iio.imwrite(file, iio.imread(file)[:20, :12])
    depth = prepared(replace(photographs, valid=valid), maps)
    assert torch.equal(depth.isnan(), ~valid)
    assert torch.equal(depth[valid], whole[valid])


def test_maps_lie_beside_the_images(scene: Scene, tmp_path: Path) -> None:
    write_maps(scene, tmp_path / "images", torch.square)
    paths = tuple(tmp_path / "images" / f"{Path(label).stem}.jpg" for label in scene.info.labels)
    photographs = replace(scene.photographs(), paths=paths)
    assert prepared(photographs).shape == (3, 24, 24)
    (tmp_path / "images" / "2_depth.png").unlink()
    message = r"images/2_depth\.png, the depth map of .*2\.jpg, is missing"
    with pytest.raises(NerfregError, match=message):
        prepared(photographs)


def test_scene_without_files_says_which_map_it_would_read(make) -> None:
    with pytest.raises(NerfregError, match=r"reg\.depth_ranks: train/0_depth\.png"):
        make("+reg=depth_ranks")


def prepared(photographs: Photographs, *overrides: str) -> Tensor:
    from nerfreg_depth_ranks import DepthRanks  # installed for this test

    maps = overrides[0].partition("=")[2] if overrides else ""
    return Hooks({"depth_ranks": DepthRanks(maps=maps)}).prepare(photographs)["depth_ranks.depth"]

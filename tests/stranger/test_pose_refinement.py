"""Pose refinement, a package of a stranger: parameters, rays that have a gradient, metrics."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from nerfreg.evaluation.scores import score_views
from nerfreg.evaluation.trained import evaluated
from nerfreg.hooks import Rays
from nerfreg.scenes import Scene
from nerfreg.training.trainer import Trainer

DEGREE, DISTANCE = math.pi / 180, 4.0
"""Of the disturbance; of the cameras from what they look at."""
SCENE = (
    "scene.size=64", "scene.views=24", "scene.test_views=2", "train.rays=512", "train.steps=200",
    "sampler.coarse=16", "sampler.fine=16", "sampler.skip_resolution=32", "field.base=8",
    "field.levels=6", "field.finest=128", "field.log2_entries=14", "field.hidden=32",
)  # fmt: skip
pytestmark = pytest.mark.usefixtures("gallery")


def turned(vectors: Tensor) -> Tensor:
    """Rotation matrices (V, 3, 3) of rotation vectors (V, 3)."""
    x, y, z = vectors.unbind(dim=1)
    zero = torch.zeros_like(x)
    rows = ((zero, -z, y), (z, zero, -x), (-y, x, zero))
    return torch.matrix_exp(torch.stack([torch.stack(row, dim=1) for row in rows], dim=1))


def disturbed(scene: Scene) -> Scene:
    """Turn each training camera by 1 degree and move it by 1 % of its distance, at random."""
    generator = torch.Generator().manual_seed(0)
    train, poses = list(scene.train), scene.cameras.poses.clone()
    turn, shift = torch.nn.functional.normalize(
        torch.randn(2, len(train), 3, generator=generator), dim=-1
    )
    poses[train, :, :3] = turned(DEGREE * turn) @ poses[train, :, :3]
    poses[train, :, 3] += 0.01 * DISTANCE * shift
    return replace(scene, cameras=replace(scene.cameras, poses=poses))


def psnr(trainer: Trainer, true: Scene) -> float:
    """PSNR over the test views, whose poses are the true ones."""
    assert torch.equal(
        true.cameras.poses[list(true.test)], trainer.scene.cameras.poses[list(true.test)]
    )
    with evaluated(trainer) as field:
        renderer = field.renderer()
        render = lambda view: renderer.view(true.cameras, view)  # noqa: E731
        return score_views(true, true.test, render, None).psnr


def refined(trainer: Trainer) -> Tensor:
    """Poses of the training views (V, 3, 4) as the plugin refines them."""
    plugin, scene = trainer.hooks.plugins["pose_refinement"], trainer.scene
    poses, views = scene.cameras.poses[list(scene.train)], torch.arange(len(scene.train))
    step = replace(trainer._step(), training=False)
    columns = []
    with torch.no_grad():
        # The axes of a camera are turned as the directions of its rays are.
        for column in range(3):
            rays = Rays(poses[:, :, 3], poses[:, :, column], *torch.ones(2, len(views)), view=views)
            moved = trainer.hooks.rays(rays, step)
            columns.append(moved.directions)
    assert plugin.in_evaluation == ("nerfreg_rays",)
    return torch.stack([*columns, moved.origins], dim=2)


def reprojection_error(true: Scene, poses: Tensor) -> float:
    """Mean distance in pixels of where cameras show surface points from where they are seen."""
    errors = []
    for place, view in enumerate(true.train):
        origins, directions = true.cameras.image_rays(view)
        depth = true.read_depth(view).flatten()[:, None]
        points = (origins + directions * depth)[depth.isfinite()[:, 0]]
        cameras = replace(true.cameras.of(true.train), poses=poses)
        found = cameras.project(points, place)
        errors.append((found - true.cameras.project(points, view)).norm(dim=1).mean())
    return float(torch.stack(errors).mean())


def test_recovers_disturbed_poses_and_gains_a_decibel(make) -> None:
    kept: list[Scene] = []

    def change(scene: Scene) -> Scene:
        kept.append(scene)
        return disturbed(scene)

    scores = []
    for plugins in ((), ("+reg=pose_refinement",)):
        trainer = make(*SCENE, *plugins, change=change)
        while trainer.budget.fraction < 1:
            trainer.step()
        scores.append(psnr(trainer, kept[0]))
    assert scores[1] > scores[0] + 1
    true, wrong = kept[0], trainer.scene.cameras.poses[list(trainer.scene.train)]
    before, after = (reprojection_error(true, poses) for poses in (wrong, refined(trainer)))
    assert before > 1  # pixels of 64
    assert after < before / 3


def test_corrections_neither_move_nor_turn_nor_scale_the_scene(make) -> None:
    trainer = make("+reg=pose_refinement")
    corrections = trainer.field.plugins["pose_refinement"]
    with torch.no_grad():
        corrections.values.normal_(generator=torch.Generator().manual_seed(0))
        corrections.values += 1  # which has no effect
        turns, shifts = corrections()
    scene = trainer.scene.info
    outwards = torch.nn.functional.normalize(scene.cameras.positions - scene.center, dim=1)
    assert abs(float((shifts[:-1] * outwards).sum())) < 1e-5
    torch.testing.assert_close(turns @ turns.mT, torch.eye(3).expand(4, 3, 3))
    # The last row is for views that are not trained on.
    torch.testing.assert_close(turns[-1], torch.eye(3))
    assert not shifts[-1].any()


def test_only_rays_of_training_views_are_moved(make) -> None:
    trainer = make("+reg=pose_refinement")
    trainer.field.plugins["pose_refinement"].values.data[1] = 0.1
    rays = Rays(*torch.rand(2, 4, 3), *torch.ones(2, 4), view=torch.tensor([0, 1, 2, -1]))
    for training in (True, False):
        moved = trainer.hooks.rays(rays, replace(trainer._step(), training=training))
        same = (moved.origins == rays.origins).all(dim=1) & (
            moved.directions == rays.directions
        ).all(dim=1)
        assert not same[:3].any()
        torch.testing.assert_close(moved.origins[3], rays.origins[3])
        torch.testing.assert_close(moved.directions[3], rays.directions[3])

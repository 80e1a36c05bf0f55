from __future__ import annotations

import torch

from nerfreg.checks.inputs import Inputs, cast
from nerfreg.hooks import Rays


def batch() -> Inputs:
    """Five rays, four of them a patch with targets; ray i can be told by its density, i."""
    number = torch.arange(5.0)
    rays = Rays(
        origins=number[:, None].expand(5, 3),
        directions=torch.tensor([[0.0, 0.0, 1.0]]).expand(5, 3),
        near=number,
        far=number + 1,
        targets=number[:4, None].expand(4, 3),
        background=number[:, None].expand(5, 3),
        patches=torch.tensor([[[0, 1], [2, 3]]]),
        neighbors=torch.tensor([[0, 1], [2, 3], [0, 2]]),
        unseen=torch.tensor([4]),
        unseen_patches=torch.tensor([[[4]]]),
        known_depth=torch.stack([number, number + 1], dim=1)[:4],
    )
    edges = torch.stack([number, number + 1], dim=1)
    return Inputs(
        rays,
        number[:, None],
        number[:, None, None].expand(5, 1, 3),
        edges,
        torch.zeros(5, 1, 4),
        (0.0, 6.0),
    )


def assert_consistent(inputs: Inputs, copies: int) -> None:
    """Wherever the rays went, their numbers and the indices that mean them went along."""
    number = inputs.density[:, 0]
    rays = inputs.rays
    for values in (rays.origins, rays.background, inputs.colors[:, 0]):
        assert torch.equal(values[:, 0], number)
    assert torch.equal(rays.far, number + 1)
    assert torch.equal(rays.targets[:, 0], number[: len(rays.targets)])
    assert torch.equal(rays.known_depth[:, 1], number[: len(rays.targets)] + 1)
    assert torch.equal(
        number[rays.patches], torch.tensor([[[0.0, 1.0], [2.0, 3.0]]]).repeat(copies, 1, 1)
    )
    assert torch.equal(
        number[rays.neighbors], torch.tensor([[0.0, 1.0], [2.0, 3.0], [0.0, 2.0]]).repeat(copies, 1)
    )
    assert torch.equal(number[rays.unseen], torch.full((copies,), 4.0))
    assert torch.equal(number[rays.unseen_patches], torch.full((copies, 1, 1), 4.0))


def test_permuted():
    permuted = batch().permuted(torch.Generator().manual_seed(0))
    assert permuted.density[:, 0].tolist() != [0, 1, 2, 3, 4]
    assert sorted(permuted.density[:4, 0].tolist()) == [0, 1, 2, 3]
    assert_consistent(permuted, 1)


def test_repeated_keeps_rays_with_targets_in_front():
    repeated = batch().repeated(3)
    assert repeated.density[:, 0].tolist() == [0, 1, 2, 3] * 3 + [4] * 3
    assert repeated.rays.patches.flatten().tolist() == list(range(12))
    assert repeated.rays.unseen.tolist() == [12, 13, 14]
    assert_consistent(repeated, 3)


def test_scaled_keeps_optical_thickness():
    scaled = batch().scaled(4.0)
    assert torch.equal(
        scaled.density * scaled.t_edges.diff(), batch().density * batch().t_edges.diff()
    )
    assert scaled.bounds == (0.0, 24.0)
    assert scaled.rays.far.tolist() == [4, 8, 12, 16, 20]
    assert scaled.rays.known_depth[:, 1].tolist() == [4, 8, 12, 16]
    assert torch.equal(scaled.rays.directions, batch().rays.directions)
    assert torch.equal(scaled.rays.targets, batch().rays.targets)


def test_cast_rounds_every_number_and_no_index():
    inputs = cast(batch(), torch.bfloat16)
    rays = inputs.rays
    floats = (
        inputs.density,
        inputs.colors,
        inputs.t_edges,
        rays.near,
        rays.targets,
        rays.background,
    )
    assert {tensor.dtype for tensor in floats} == {torch.bfloat16}
    assert rays.patches.dtype == rays.neighbors.dtype == rays.unseen.dtype == torch.int64

"""The hash grid: interpolation by hand, both implementations, gradients and edges."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from nerfreg.field import grid_numba, grid_torch
from nerfreg.field.grid import HashGrid
from nerfreg.field.grid_layout import GridLayout

HASHED = GridLayout(levels=8, base=4, finest=64, log2_entries=10)


def test_resolutions_grow_geometrically_from_base_to_finest() -> None:
    # growth (2048/16)^(1/7) = 2, hence powers of two
    assert GridLayout(8, 16, 2048, 19).resolutions.tolist() == [
        16,
        32,
        64,
        128,
        256,
        512,
        1024,
        2048,
    ]


def test_a_level_is_dense_exactly_when_its_vertices_fit() -> None:
    # (7+1)^3 = 512 = 2^9 fits into 2^9 entries, (8+1)^3 = 729 does not
    layout = GridLayout(2, 7, 8, 9)
    assert layout.dense.tolist() == [True, False]
    assert layout.offsets.tolist() == [0, 512, 1024]


def test_interpolation_in_one_dense_cell() -> None:
    # One level, one cell: vertices at the corners of the cube, x fastest. The table holds
    # x + 2y + 4z of each vertex, so trilinear interpolation gives x + 2y + 4z everywhere, and half
    # of that in the second feature.
    layout = GridLayout(1, 1, 1, 4)
    values = torch.arange(8.0)
    table = torch.stack([values, values / 2], dim=1)
    positions = torch.tensor([[0.25, 0.5, 0.75], [0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
    expected = positions @ torch.tensor([1.0, 2.0, 4.0])
    for encode in (grid_torch.encode, grid_numba.encode):
        features = encode(positions, table, layout, 1)
        torch.testing.assert_close(features, torch.stack([expected, expected / 2], dim=1))


def test_hashed_vertices_use_the_published_primes() -> None:
    # 16 cells a side, 2^4 entries: vertex (3, 5, 7) is at
    # (3 xor 5 * 2654435761 xor 7 * 805459861) mod 16. As 2654435761 = 1 and 805459861 = 5 mod 16,
    # that is 3 xor 5 xor 35 mod 16 = 3 xor 5 xor 3 = 5.
    layout = GridLayout(1, 16, 16, 4)
    table = torch.arange(16.0)[:, None].expand(16, 2).contiguous()
    positions = torch.tensor([[3.0, 5.0, 7.0]]) / 16
    for encode in (grid_torch.encode, grid_numba.encode):
        assert encode(positions, table, layout, 1)[0, 0].item() == 5


@pytest.mark.parametrize("levels", [1, 5, 8])
def test_compiled_and_plain_agree_forward_and_backward(levels: int) -> None:
    results = []
    for encode in (grid_torch.encode, grid_numba.encode):
        torch.manual_seed(levels)
        table = torch.randn(HASHED.entries, 2, requires_grad=True)
        positions = torch.rand(500, 3)
        positions[:8] = torch.tensor(
            [[i & 1, i >> 1 & 1, i >> 2] for i in range(8)]
        )  # the cube's own corners
        positions.requires_grad_()
        features = encode(positions, table, HASHED, levels)
        assert features.shape == (500, 2 * levels)
        loss = (features * torch.randn(500, 2 * levels)).sum()
        results.append((features.detach(), *torch.autograd.grad(loss, (table, positions))))
    for plain, compiled in zip(*results, strict=True):
        torch.testing.assert_close(compiled, plain, rtol=1e-5, atol=1e-5 * float(plain.abs().max()))


def test_gradients_of_the_plain_grid_match_finite_differences() -> None:
    torch.manual_seed(0)
    layout = GridLayout(3, 2, 8, 6)
    table = torch.randn(layout.entries, 2, dtype=torch.float64, requires_grad=True)
    positions = (torch.rand(5, 3, dtype=torch.float64) * 0.9 + 0.03).requires_grad_()
    assert torch.autograd.gradcheck(
        lambda p, t: grid_torch.encode(p, t, layout, 3), (positions, table)
    )


def test_backward_is_the_same_for_any_number_of_threads() -> None:
    import numba

    torch.manual_seed(0)
    positions, grad = torch.rand(3000, 3), torch.randn(3000, 2 * HASHED.levels)
    table = torch.randn(HASHED.entries, 2, requires_grad=True)

    def gradient(threads: int) -> Tensor:
        before = numba.get_num_threads()
        numba.set_num_threads(threads)
        try:
            return torch.autograd.grad(
                grid_numba.encode(positions, table, HASHED, HASHED.levels), table, grad
            )[0]
        finally:
            numba.set_num_threads(before)

    assert torch.equal(gradient(1), gradient(numba.config.NUMBA_NUM_THREADS))


@pytest.mark.parametrize("encode", [grid_torch.encode, grid_numba.encode])
def test_positions_outside_the_cube_stay_inside_the_table(encode):
    table = torch.ones(HASHED.entries, 2)
    positions = torch.tensor([[-0.01, 0.5, 1.01], [1.0 + 1e-6, -1e-6, 0.5]])
    # weights of a cell sum to 1 outside it as well, so a constant table gives the constant
    torch.testing.assert_close(
        encode(positions, table, HASHED, 8), torch.ones(2, 16), rtol=1e-4, atol=1e-4
    )


def test_no_points_and_no_levels() -> None:
    for encode in (grid_torch.encode, grid_numba.encode):
        assert encode(torch.rand(5, 3), torch.rand(HASHED.entries, 2), HASHED, 0).shape == (5, 0)
    assert grid_numba.encode(torch.rand(0, 3), torch.rand(HASHED.entries, 2), HASHED, 8).shape == (
        0,
        16,
    )


def test_float64_goes_through_plain_torch() -> None:
    grid = HashGrid(GridLayout(2, 4, 8, 6)).double()
    assert grid(torch.rand(3, 3, dtype=torch.float64), 2).dtype == torch.float64


def test_silenced_levels_get_no_gradient() -> None:
    grid = HashGrid(HASHED)
    grid(torch.rand(50, 3), 3).sum().backward()
    assert grid.table.grad is not None
    end = int(HASHED.offsets[3])
    assert grid.table.grad[:end].abs().sum() > 0
    assert np.all(grid.table.grad[end:].numpy() == 0)


def test_encodings_that_share_a_gradient_give_the_sum_of_theirs() -> None:
    torch.manual_seed(0)
    grid = HashGrid(HASHED)
    first, second = torch.rand(200, 3, requires_grad=True), torch.rand(300, 3)

    def loss() -> Tensor:
        return grid(first, 8).square().sum() + grid(second, 5).sum()

    expected = torch.autograd.grad(loss(), (grid.table, first))
    with grid.one_gradient():
        shared = loss()
    # twice through the same graph, a pass that does not reach the table in between, then into .grad
    for _ in range(2):
        for value, wanted in zip(
            torch.autograd.grad(shared, (grid.table, first), retain_graph=True),
            expected,
            strict=True,
        ):
            torch.testing.assert_close(value, wanted)
        torch.testing.assert_close(
            torch.autograd.grad(shared, first, retain_graph=True)[0], expected[1]
        )
    shared.backward()
    assert grid.table.grad is not None
    torch.testing.assert_close(grid.table.grad, expected[0])
    # what else depends on the table is added as ever
    with grid.one_gradient():
        both = loss() + grid.table.sum()
    torch.testing.assert_close(torch.autograd.grad(both, grid.table)[0], expected[0] + 1)

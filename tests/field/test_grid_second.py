"""Second derivatives of the hash grid: both implementations, finite differences, and refusals."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import NamedTuple

import numba
import pytest
import torch
from torch import Tensor

from nerfreg.errors import NerfregError
from nerfreg.field import grid_numba, grid_torch
from nerfreg.field.grid import HashGrid
from nerfreg.field.grid_layout import GridLayout

LAYOUT = GridLayout(levels=8, base=4, finest=64, log2_entries=10)
"""Cells 4, 5, 8, ... a side: the first three levels are dense, the other five hashed."""


class Point(NamedTuple):
    """Where a derivative is taken: all inputs of the gradient and what comes back to it."""

    positions: Tensor
    grad: Tensor
    table: Tensor
    back: Tensor


def points(count: int, levels: int, layout: GridLayout = LAYOUT) -> Point:
    """Random points; the first are corners of the cube, vertices of the finest level and faces."""
    torch.manual_seed(count + levels)
    positions = torch.rand(count, 3)
    positions[:8] = torch.tensor([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)])
    positions[8:16] = torch.randint(0, layout.finest + 1, (8, 3)) / layout.finest
    positions[16:24, 0] = 1
    return Point(
        positions,
        torch.randn(count, 2 * levels),
        torch.randn(layout.entries, 2),
        torch.randn(count, 3),
    )


def by_all(backend: ModuleType, point: Point, dtype: torch.dtype) -> list[Tensor]:
    """The gradient, and what `back` gives by positions, incoming gradient and table."""
    inputs = tuple(values.to(dtype).requires_grad_() for values in point[:3])
    gradient = backend.gradient(*inputs, LAYOUT)
    return [gradient, *torch.autograd.grad(gradient, inputs, point.back.to(dtype))]


def assert_close(values: list[Tensor], exact: list[Tensor]) -> None:
    for value, wanted in zip(values, exact, strict=True):
        # float32 adds products of cells, up to 64 squared, times numbers near 1 that cancel
        torch.testing.assert_close(
            value.double(), wanted, rtol=1e-4, atol=4e-6 * float(wanted.detach().abs().max())
        )


@pytest.mark.parametrize("levels", [1, 5, 8])
def test_compiled_second_derivatives_are_those_of_the_plain_grid(levels: int) -> None:
    point = points(500, levels)
    exact = by_all(grid_torch, point, torch.float64)
    assert_close(by_all(grid_torch, point, torch.float32), exact)
    assert_close(by_all(grid_numba, point, torch.float32), exact)
    # the table of levels that were not evaluated
    assert not exact[3][int(LAYOUT.offsets[levels]) :].any()


def test_gradient_of_the_plain_grid_matches_finite_differences() -> None:
    # one dense and two hashed levels; points keep away from borders, where gradients jump
    torch.manual_seed(0)
    layout = GridLayout(3, 2, 8, 6)
    assert layout.dense.tolist() == [True, False, False]
    cells = torch.tensor([[0, 1, 7], [3, 5, 2], [6, 4, 0], [7, 7, 7]])
    positions = (cells + torch.rand(4, 3, dtype=torch.float64) * 0.8 + 0.1) / 8
    inputs = (positions, torch.randn(4, 6).double(), torch.randn(layout.entries, 2).double())
    assert torch.autograd.gradcheck(
        lambda p, g, t: grid_torch.gradient(p, g, t, layout),
        tuple(values.requires_grad_() for values in inputs),
    )


def test_second_derivatives_in_one_cell_by_hand() -> None:
    # The table holds x y of each vertex of the single cell, so the first feature is x y, whose
    # gradient is (y, x, 0) and whose only second derivative is the mixed one, 1. Going back with
    # (a, b, c): by positions (b, a, 0), by the incoming gradient a y + b x.
    layout = GridLayout(1, 1, 1, 4)
    table = torch.tensor([[float(i == 3 or i == 7), 0.0] for i in range(8)])
    x, y, a, b = 0.25, 0.75, 3.0, 5.0
    for backend in (grid_torch, grid_numba):
        positions = torch.tensor([[x, y, 0.5]], requires_grad=True)
        grad = torch.tensor([[1.0, 0.0]], requires_grad=True)
        gradient = backend.gradient(positions, grad, table, layout)
        torch.testing.assert_close(gradient, torch.tensor([[y, x, 0]]))
        back = torch.autograd.grad(gradient, (positions, grad), torch.tensor([[a, b, 7.0]]))
        torch.testing.assert_close(back[0], torch.tensor([[b, a, 0]]), rtol=1e-6, atol=1e-6)
        torch.testing.assert_close(back[1], torch.tensor([[a * y + b * x, 0]]))


def test_a_graph_through_the_backward_pass_of_an_encoding_is_right() -> None:
    # The derivative of every gradient of an encoding by everything, as autograd finds it.
    point = points(300, 6)
    back = torch.randn(LAYOUT.entries, 2)

    def derivatives(backend: ModuleType, dtype: torch.dtype) -> list[Tensor]:
        positions, grad, table = (values.to(dtype).requires_grad_() for values in point[:3])
        features = backend.encode(positions, table, LAYOUT, 6)
        first = torch.autograd.grad(features, (positions, table), grad, create_graph=True)
        loss = (first[0] * point.back.to(dtype)).sum() + (first[1] * back.to(dtype)).sum()
        return [*first, *torch.autograd.grad(loss, (positions, grad, table))]

    assert_close(derivatives(grid_numba, torch.float32), derivatives(grid_torch, torch.float64))


def test_a_loss_on_gradient_and_features_adds_both_to_one_buffer() -> None:
    point = points(300, 8)

    def loss(grid: HashGrid, dtype: torch.dtype) -> Tensor:
        positions = point.positions.to(dtype).requires_grad_()
        features = grid(positions, 8)
        density = (features.square() * point.grad.to(dtype)).sum(dim=1)
        (normal,) = torch.autograd.grad(density.sum(), positions, create_graph=True)
        return (normal * point.back.to(dtype)).sum() + features.square().sum()

    torch.manual_seed(0)
    grid = HashGrid(LAYOUT)
    torch.nn.init.normal_(grid.table)
    with grid.one_gradient():
        shared = loss(grid, torch.float32)
    shared.backward()
    exact = HashGrid(LAYOUT).double()
    exact.load_state_dict(grid.state_dict())
    loss(exact, torch.float64).backward()
    assert grid.table.grad is not None and exact.table.grad is not None
    assert_close([grid.table.grad], [exact.table.grad])


def test_gradient_of_the_module_uses_either_backend() -> None:
    point = points(50, 3)
    compiled, plain = HashGrid(LAYOUT), HashGrid(LAYOUT, "torch")
    plain.load_state_dict(compiled.state_dict())
    values = [grid.gradient(point.positions, point.grad) for grid in (compiled, plain)]
    torch.testing.assert_close(*values, rtol=1e-4, atol=1e-6)
    # an encoding's own gradient, from autograd
    positions = point.positions.clone().requires_grad_()
    by_autograd = torch.autograd.grad(compiled(positions, 3), positions, point.grad)[0]
    assert torch.equal(by_autograd, values[0].detach())
    for grid in (compiled, plain):
        none = grid.gradient(point.positions, point.grad[:, :0])
        assert torch.equal(none, torch.zeros(50, 3))
        assert grid.gradient(point.positions[:0], point.grad[:0]).shape == (0, 3)


def test_second_derivatives_are_the_same_for_any_number_of_threads() -> None:
    # 3001 points: neither the shares of the threads nor the last block are full
    point = points(3001, 8)

    def with_threads(count: int) -> list[Tensor]:
        before = numba.get_num_threads()
        numba.set_num_threads(count)
        try:
            return by_all(grid_numba, point, torch.float32)
        finally:
            numba.set_num_threads(before)

    alone, together = with_threads(1), with_threads(numba.config.NUMBA_NUM_THREADS)
    assert all(torch.equal(*pair) for pair in zip(alone, together, strict=True))


@pytest.mark.parametrize(
    ("inputs", "scatters", "slopes"), [("table", 1, 0), ("positions", 0, 1), ("both", 1, 1)]
)
def test_a_pass_computes_only_what_it_is_asked_for(
    monkeypatch: pytest.MonkeyPatch, inputs: str, scatters: int, slopes: int
) -> None:
    calls = {"backward_table": 0, "backward_positions": 0}

    def counted(name: str) -> Callable[..., None]:
        kernel = getattr(grid_numba.grid_kernels, name)

        def call(*arguments: object) -> None:
            calls[name] += 1
            kernel(*arguments)

        return call

    for name in calls:
        monkeypatch.setattr(grid_numba.grid_kernels, name, counted(name))
    grid = HashGrid(LAYOUT)
    positions = torch.rand(20, 3, requires_grad=True)
    wanted = {"table": [grid.table], "positions": [positions], "both": [grid.table, positions]}
    torch.autograd.grad(grid(positions, 8).sum(), wanted[inputs])
    assert calls == {"backward_table": scatters, "backward_positions": slopes}


def test_a_third_derivative_is_refused_and_not_wrong() -> None:
    point = points(30, 8)
    positions, grad, table = (values.requires_grad_() for values in point[:3])
    gradient = grid_numba.gradient(positions, grad, table, LAYOUT)
    second = torch.autograd.grad(gradient.square().sum(), (positions, table), create_graph=True)
    # what was asked for has its values
    torch.testing.assert_close(
        second,
        torch.autograd.grad(
            grid_numba.gradient(positions, grad, table, LAYOUT).square().sum(), (positions, table)
        ),
    )
    for values in second:
        with pytest.raises(NerfregError, match=r"not three times; set field\.backend=torch"):
            torch.autograd.grad(values.sum(), table, retain_graph=True)

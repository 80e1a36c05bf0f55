"""What plugins see of the field."""

from __future__ import annotations

import torch

from nerfreg.hooks import FieldView, TableLevel


def test_levels_of_the_grid_can_be_read(make) -> None:
    trainer = make()
    view = trainer.renderer.view(trainer._step())
    assert isinstance(view, FieldView)
    assert [level.resolution for level in view.tables] == [16, 25, 40, 64]
    for level in view.tables:
        assert isinstance(level, TableLevel)
        assert level.table.shape == (level.entries, 2)
        cells = torch.randint(level.resolution, (50, 3))
        steps = torch.eye(3, dtype=torch.long)
        expected = sum(
            (level.features(cells + axis) - level.features(cells)).square().sum(-1)
            for axis in steps
        )
        torch.testing.assert_close(level.squared_differences(cells), expected)
        if level.dense:
            x, y, z = cells.unbind(-1)
            side = level.resolution + 1
            entries = level.table[x + side * (y + side * z)]
            torch.testing.assert_close(level.features(cells), entries)


def test_gradient_of_the_density_and_its_own(make) -> None:
    found = []
    for backend in ("numba", "torch"):
        trainer = make(f"field.backend={backend}")
        with torch.no_grad():
            trainer.field.grid.table.mul_(1e3)
        view = trainer.renderer.view(trainer._step())
        low, high = trainer.scene.box
        torch.manual_seed(0)
        points = torch.lerp(low, high, torch.rand(100, 3)).requires_grad_()
        gradient = view.density_gradient(points)
        (expected,) = torch.autograd.grad(view.density(points).sum(), points)
        torch.testing.assert_close(gradient, expected, rtol=1e-4, atol=1e-5)
        assert not view.density_gradient(points.detach(), create_graph=False).requires_grad
        weights = [trainer.field.grid.table, *trainer.field.density_network.parameters()]
        found.append(torch.autograd.grad(gradient.square().sum(), [points, *weights]))
    for compiled, plain in zip(*found, strict=True):
        assert float(plain.abs().max()) > 0
        torch.testing.assert_close(compiled, plain, rtol=1e-3, atol=1e-4 * float(plain.abs().max()))

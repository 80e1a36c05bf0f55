"""The field: scale, density activation, masks, and the layer factory."""

from __future__ import annotations

import math

import pytest
import torch

from nerfreg.field import FieldConfig, RadianceField
from nerfreg.field.layers import Linear

BOX = torch.tensor([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
SMALL = FieldConfig(levels=4, base=4, finest=16, log2_entries=10, hidden=16, geometry=7)


def make(config: FieldConfig = SMALL, box: torch.Tensor = BOX) -> RadianceField:
    torch.manual_seed(0)
    field = RadianceField(
        config, box, lambda network, index, i, o, activation: Linear(i, o, activation)
    )
    torch.nn.init.uniform_(field.grid.table, -1, 1)
    return field


def test_the_factory_is_asked_for_every_layer_once() -> None:
    calls = []

    def factory(*arguments: object) -> Linear:
        calls.append(arguments)
        return Linear(*arguments[2:])  # type: ignore[arg-type]

    RadianceField(SMALL, BOX, factory)
    assert calls == [
        ("density", 0, 8, 16, "relu"),
        ("density", 1, 16, 8, "none"),
        ("color", 0, 23, 16, "relu"),
        ("color", 1, 16, 16, "relu"),
        ("color", 2, 16, 3, "none"),
    ]


def test_density_is_the_exponential_in_units_of_half_the_box() -> None:
    field = make(box=3 * BOX)
    raw = torch.zeros(2, 8)
    raw[1, 0] = math.log(6.0)
    torch.testing.assert_close(field.density(raw), torch.tensor([1 / 3, 2.0]))


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_a_scene_of_another_scale_has_the_same_optical_thickness(scale: float) -> None:
    small, large = make(), make(box=scale * BOX)
    positions = torch.rand(20, 3) * 2 - 1
    thickness = small.density(small.raw_density(positions)) * 0.1
    other = large.density(large.raw_density(positions * scale)) * (0.1 * scale)
    torch.testing.assert_close(other, thickness, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("raw", [-1e4, -100.0, 0.0, 14.9, 15.1, 100.0, 1e4])
def test_density_and_its_gradient_are_finite_for_any_raw_output(raw: float) -> None:
    field = make()
    value = torch.full((1, 8), raw, requires_grad=True)
    density = field.density(value)
    density.sum().backward()
    assert value.grad is not None and torch.isfinite(value.grad).all()
    expected = math.exp(min(raw, 15.0))
    torch.testing.assert_close(density, torch.tensor([expected]), rtol=1e-5, atol=1e-30)
    # the documented clip: beyond 15 the gradient stays that at 15, so that the density can come
    # back
    torch.testing.assert_close(value.grad[:, 0], torch.tensor([expected]), rtol=1e-5, atol=1e-30)


@pytest.mark.parametrize("active", [-1.0, 0.0, 0.5, 1.0, 3.0, 4.5, 8.0, 9.0])
def test_silenced_features_are_zeros_before_the_network(active: float) -> None:
    field = make()
    positions = torch.rand(30, 3) * 2 - 1
    features = field.grid((positions + 1) / 2, 4).detach()
    alive = (active - torch.arange(8)).clamp(0, 1)
    expected = field.density_network(features * alive)
    torch.testing.assert_close(field.raw_density(positions, active), expected)


def test_color_lies_in_the_unit_interval_and_follows_the_direction() -> None:
    field = make()
    raw = torch.randn(6, 8)
    harmonics = torch.randn(6, 16)
    color = field.color(raw, harmonics)
    assert ((color > 0) & (color < 1)).all()
    assert not torch.allclose(color, field.color(raw, -harmonics))
    torch.testing.assert_close(
        field.color(raw, harmonics, 0.0), field.color(raw, torch.zeros(6, 16))
    )


def test_both_backends_give_the_same_field() -> None:
    numba, plain = make(), make(FieldConfig(**{**vars(SMALL), "backend": "torch"}))
    positions = torch.rand(100, 3) * 2 - 1
    torch.testing.assert_close(
        numba.raw_density(positions), plain.raw_density(positions), rtol=1e-5, atol=1e-6
    )

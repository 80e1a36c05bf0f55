from __future__ import annotations

import pytest
import torch
from nerfreg_plugins.adversarial import Perturbed
from nerfreg_plugins.view_dependence import Damped, ViewDependence, damping

from nerfreg.field.directions import spherical_harmonics
from nerfreg.field.layers import Linear
from nerfreg.registry import Hooks


def test_damping_by_hand():
    # degree 0 once, 1 three times, 2 five times, 3 seven times; the two features behind them are
    # left alone
    factors = damping(18, 0.5)
    assert factors.tolist() == [1.0] + [0.5] * 3 + [0.25] * 5 + [0.125] * 7 + [1.0, 1.0]
    assert damping(16, 1.0).tolist() == [1.0] * 16
    assert damping(16, 0.0).tolist() == [1.0] + [0.0] * 15


def test_degrees_are_those_of_the_harmonics():
    """A harmonic of degree l turns its sign with the direction if l is odd, and only then."""
    directions = torch.nn.functional.normalize(torch.randn(5, 3), dim=-1)
    signs = damping(16, -1.0)
    torch.testing.assert_close(
        spherical_harmonics(-directions), signs * spherical_harmonics(directions)
    )


def test_only_the_first_colour_layer_is_damped():
    hooks = Hooks({"view_dependence": ViewDependence()})
    made = {
        (network, index): hooks.layer(network, index, 31, 8, "relu")
        for network in ("density", "color")
        for index in (0, 1)
    }
    assert [key for key, layer in made.items() if isinstance(layer, Damped)] == [("color", 0)]


def test_the_layer_sees_its_input_damped():
    layer = Hooks({"view_dependence": ViewDependence(scale=0.1)}).layer("color", 0, 17, 3, "relu")
    x = torch.randn(6, 17)
    seen = x.clone()
    seen[:, 1:4] *= 0.1
    seen[:, 4:9] *= 0.01
    seen[:, 9:16] *= 0.001
    torch.testing.assert_close(layer(x), layer.inner(seen))
    weight, bias = layer.effective()
    torch.testing.assert_close((x @ weight.T).relu(), layer(x))
    assert bias is None


def test_a_layer_inside_that_is_not_affine_or_shifted():
    x = torch.randn(4, 2)
    factors = torch.tensor([1.0, 0.5])
    stranger = Damped(torch.nn.Sequential(torch.nn.Linear(2, 1), torch.nn.Tanh()), factors)
    assert stranger.effective() is None
    torch.testing.assert_close(stranger(x), stranger.inner(x * factors))
    shifted = Perturbed(Linear(2, 3), 2, 3)
    damped = Damped(shifted, factors)
    shifted.raw = torch.ones(4, 3)
    assert torch.equal(damped.output_shift(), torch.ones(4, 3))
    assert damped.effective() is not None
    shifted.features = torch.ones(4, 2)
    assert damped.effective() is None
    torch.testing.assert_close(damped(x), (x * factors + 1) @ shifted.inner.weight.T + 1)


@pytest.mark.parametrize("scale", [0.0, 1.0])
def test_nothing_of_the_direction_and_all_of_it(scale):
    layer = Damped(Linear(16, 3), damping(16, scale))
    a, b = (
        spherical_harmonics(torch.nn.functional.normalize(torch.randn(5, 3), dim=-1))
        for _ in range(2)
    )
    assert torch.allclose(layer(a), layer(b)) == (scale == 0.0)

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
from nerfreg_plugins.adversarial import Adversarial, Perturbed, pgd_step

from nerfreg import Rendering, Samples, Step
from nerfreg.errors import NerfregError
from nerfreg.field.layers import Linear
from nerfreg.registry import Hooks

OFF = {"positions": 0.0, "directions": 0.0, "t": 0.0, "features": 0.0, "sigma": 0.0, "rgb": 0.0}
LENGTH = 4.0  # of the scene, from 2 to 6


def only(**radii: float) -> Adversarial:
    return Adversarial(**{**OFF, **radii})


def test_pgd_step_by_hand(dtype):
    delta = torch.tensor([0.0, 0.0, 0.0, 0.4, -0.5], dtype=dtype)
    grad = torch.tensor([3.0, -1e-30, 0.0, 1.0, 1e30], dtype=dtype)
    expected = torch.tensor([0.2, -0.2, 0.0, 0.5, -0.3], dtype=dtype)
    torch.testing.assert_close(pgd_step(delta, grad, 0.2, 0.5), expected)


def test_pgd_step_stays_in_the_ball(dtype):
    delta, grad = torch.randn(2, 1000, dtype=dtype, generator=torch.Generator().manual_seed(0))
    assert pgd_step(delta, grad * torch.inf, 1e6, 0.25).abs().max() == 0.25
    assert (pgd_step(delta, grad, 1.0, 0.0) == 0).all()


def scene(plugin: Adversarial, see) -> tuple[Hooks, Step]:
    """A run in which the colour of a ray is what `see` makes of the samples."""
    hooks = Hooks({"adversarial": plugin})

    def rerender(rendering: Rendering) -> Rendering:
        rays = rendering.rays
        positions = rays.origins[:, None] + rendering.t[..., None] * rays.directions[:, None]
        samples = Samples(positions, rays.directions, rendering.t)
        return replace(rendering, rgb=see(hooks.encoder_input(samples, step)))

    renderer = SimpleNamespace(
        render=lambda rays, step, like, **options: rerender(like),
        frozen=nullcontext,
        cast=lambda rays, step: rays,
        view=lambda step: None,
    )
    step = Step(0, 1000, 0.0, torch.Generator(), (2.0, 2.0 + LENGTH), renderer)
    return hooks, step


@pytest.mark.parametrize(
    ("radii", "see", "expected"),
    [
        # One sample at t = 4, so z = -4. The error, a mean over the three equal channels, is z^2;
        # away from 0 is down.
        (
            {"positions": 0.01},
            lambda s: s.positions[:, 0, 2:].expand(-1, 3),
            (4 + 0.01 * LENGTH) ** 2,
        ),
        # Away from 0 is a larger t, for t and for the position along the ray.
        ({"t": 0.01}, lambda s: s.t.expand(-1, 3), (4 + 0.01 * LENGTH) ** 2),
        ({"t": 0.01}, lambda s: s.positions[:, 0, 2:].expand(-1, 3), (4 + 0.01 * LENGTH) ** 2),
        # x of the direction is 0; the error is (1 + x)^2 and x the radius over the new length.
        (
            {"directions": 0.1},
            lambda s: 1 + s.directions[:, :1].expand(-1, 3),
            (1 + 0.1 / 1.01**0.5) ** 2,
        ),
        # Both at once: down by 0.04 along the ray and by 0.04 on its own.
        (
            {"positions": 0.01, "t": 0.01},
            lambda s: s.positions[:, 0, 2:].expand(-1, 3),
            (4 + 0.02 * LENGTH) ** 2,
        ),
    ],
)
def test_encoder_inputs_by_hand(rendering, radii, see, expected):
    plugin = only(**radii)
    _, step = scene(plugin, see)
    term = plugin.nerfreg_loss(rendering(torch.ones(2, 1)), step)["adversarial"]
    assert term.item() == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize(
    ("steps", "step_size", "reached"), [(1, 0.25, 0.25), (3, 0.25, 0.75), (5, 0.25, 1.0)]
)
def test_steps_add_up_to_the_radius(rendering, steps, step_size, reached):
    plugin = only(t=0.01)
    plugin.steps, plugin.step_size = steps, step_size
    _, step = scene(plugin, lambda s: s.t.expand(-1, 3))
    term = plugin.nerfreg_loss(rendering(torch.ones(2, 1)), step)["adversarial"]
    assert term.item() == pytest.approx((4 + 0.01 * LENGTH * reached) ** 2)


def test_only_rays_with_a_photograph_count(rendering):
    plugin = only(t=0.01)
    _, step = scene(plugin, lambda s: s.t.expand(-1, 3) * torch.tensor([[1.0], [100.0]]))
    made = rendering(torch.ones(2, 1), targets=torch.zeros(1, 3))
    assert plugin.nerfreg_loss(made, step)["adversarial"].item() == pytest.approx(
        (4 + 0.01 * LENGTH) ** 2
    )


def test_directions_that_differ_along_the_ray(step):
    plugin = only(directions=0.1, t=0.5)
    directions = torch.tensor([[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
    plugin._deltas = {
        "directions": torch.tensor([[0.0, 0.0, 0.1]]),
        "t": torch.tensor([[1.0, 2.0]]),
    }
    seen = Hooks({"adversarial": plugin}).encoder_input(
        Samples(torch.zeros(1, 2, 3), directions, torch.zeros(1, 2)), step()
    )
    assert seen.positions.tolist() == [[[1.0, 0.0, 0.0], [0.0, 2.0, 0.0]]]
    torch.testing.assert_close(seen.directions.norm(dim=-1), torch.ones(1, 2))
    torch.testing.assert_close(seen.directions[..., 2], torch.full((1, 2), 0.1 / 1.01**0.5))


def test_perturbed_layer_is_the_inner_one_until_shifted():
    inner = Linear(2, 3, "relu")
    layer = Perturbed(inner, 2, 3)
    x = torch.randn(5, 2)
    assert layer.effective()[0] is inner.weight
    assert layer.activation == "relu"
    assert layer.input_shift() is None and layer.output_shift() is None
    assert torch.equal(layer(x), inner(x))
    layer.features = torch.ones(5, 2)
    assert torch.equal(layer(x), inner(x + 1))
    assert torch.equal(layer.input_shift(), torch.ones(5, 2))
    layer.features, layer.raw = None, torch.full((5, 1), 2.0)
    torch.testing.assert_close(layer(x) - inner(x), torch.tensor([2.0, 0.0, 0.0]).expand(5, 3))
    assert torch.equal(layer.output_shift(), torch.tensor([2.0, 0.0, 0.0]).expand(5, 3))


def test_shifts_of_the_inner_layer_are_added():
    inner = Perturbed(Linear(2, 3), 2, 3)
    layer = Perturbed(inner, 2, 3)
    inner.features, inner.raw = torch.ones(5, 2), torch.ones(5, 1)
    assert torch.equal(layer.input_shift(), torch.ones(5, 2))
    layer.features, layer.raw = torch.ones(5, 2), torch.ones(5, 3)
    assert torch.equal(layer.input_shift(), torch.full((5, 2), 2.0))
    assert torch.equal(layer.output_shift(), torch.tensor([2.0, 1.0, 1.0]).expand(5, 3))


def test_a_layer_of_any_kind_inside():
    layer = Perturbed(torch.nn.Sequential(torch.nn.Linear(2, 1), torch.nn.Tanh()), 2, 1)
    assert layer.effective() is None
    layer.raw = torch.ones(4, 1)
    x = torch.randn(4, 2)
    torch.testing.assert_close(layer(x), layer.inner(x) + 1)


@pytest.mark.parametrize(
    ("radii", "wrapped"),
    [
        ({"positions": 1.0}, set()),
        ({"features": 1.0}, {("density", 0)}),
        ({"sigma": 1.0}, {("density", 1)}),
        ({"rgb": 1.0}, {("color", 1)}),
        (
            {"features": 1.0, "sigma": 1.0, "rgb": 1.0},
            {("density", 0), ("density", 1), ("color", 1)},
        ),
    ],
)
def test_only_what_is_switched_on_is_wrapped(radii, wrapped):
    hooks = Hooks({"adversarial": only(**radii)})
    made = {
        (network, index): hooks.layer(network, index, 2, 2, activation)
        for network in ("density", "color")
        for index, activation in ((0, "relu"), (1, "none"))
    }
    assert {key for key, layer in made.items() if isinstance(layer, Perturbed)} == wrapped


def test_layers_by_hand(rendering, step):
    # Density: raw = 3 f of the one feature f = 1 (and a geometry feature 0). Colour: raw = 2 f.
    # Both weights are positive, so that every shift of 0.1 goes up. Colour of a ray: mean over its
    # coloured samples of raw sigma + rgb.
    plugin = only(features=0.1, sigma=0.1, rgb=0.1)
    hooks = Hooks({"adversarial": plugin})
    density, color = hooks.layer("density", 0, 1, 2, "none"), hooks.layer("color", 0, 1, 3, "none")
    density.inner.weight.data = torch.tensor([[3.0], [0.0]])
    color.inner.weight.data = torch.full((3, 1), 2.0)
    made = rendering(torch.tensor([[1.0, 0.0], [1.0, 0.0]]))  # each ray has one coloured sample
    assert made.colored.tolist() == [[True, False]] * 2

    def rerender(rendering: Rendering) -> Rendering:
        sigma = density(torch.ones(4, 1)).reshape(2, 2, 2)
        assert (sigma[..., 1] == 0).all(), "geometry features are left alone"
        return replace(rendering, rgb=sigma[:, 0, :1] + color(torch.ones(2, 1)))

    term = plugin.nerfreg_loss(made, step(rerender=rerender))["adversarial"]
    # 3 * 1.1 + 0.1 + 2 + 0.1; only the feature that the density network sees is shifted.
    assert term.item() == pytest.approx(5.5**2)
    # d error / d W = 2 * 5.5 * 1.1 for the weight of sigma: the term trains the field under the
    # perturbation.
    grad = torch.autograd.grad(term, density.inner.weight)[0]
    torch.testing.assert_close(grad, torch.tensor([[2 * 5.5 * 1.1], [0.0]]))
    assert density.input_shift() is None and density.output_shift() is None
    assert color.output_shift() is None


def test_no_coloured_sample(rendering, step):
    plugin = only(rgb=0.1)
    layer = Hooks({"adversarial": plugin}).layer("color", 0, 1, 3, "none")
    made = rendering(torch.zeros(2, 3))
    state = step(rerender=lambda r: replace(r, rgb=layer(torch.ones(0, 1)).sum() + r.rgb))
    assert plugin.nerfreg_loss(made, state)["adversarial"] == 1  # white against black


def test_nothing_stays_perturbed_when_rendering_fails(rendering, step):
    plugin = only(t=0.1, sigma=0.1)
    layer = Hooks({"adversarial": plugin}).layer("density", 0, 1, 2, "none")

    def fail(rendering: Rendering) -> Rendering:
        raise MemoryError

    with pytest.raises(MemoryError):
        plugin.nerfreg_loss(rendering(torch.ones(2, 1)), step(rerender=fail))
    samples = Samples(torch.zeros(2, 1, 3), torch.zeros(2, 3), torch.zeros(2, 1))
    assert Hooks({"adversarial": plugin}).encoder_input(samples, step()) is samples
    assert layer.output_shift() is None


def test_targets_that_the_colour_does_not_depend_on_do_no_harm(rendering):
    plugin = only(directions=0.1, t=0.01)
    _, step = scene(plugin, lambda s: s.t.expand(-1, 3))
    term = plugin.nerfreg_loss(rendering(torch.ones(2, 1)), step)["adversarial"]
    assert term.item() == pytest.approx((4 + 0.01 * LENGTH) ** 2)


def test_a_radius_below_0_is_refused() -> None:
    with pytest.raises(NerfregError, match="positions"):
        Adversarial(positions=-1.0)

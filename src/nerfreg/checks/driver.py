"""Renders the rays of a case through the real compositor and a plugin's hooks, as the renderer does with a field."""

from __future__ import annotations

import math
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from nerfreg.checks.inputs import Inputs
from nerfreg.field.network import Network
from nerfreg.hooks import Rays, Rendering, Samples, Step
from nerfreg.numerics import single
from nerfreg.registry import Hooks
from nerfreg.rendering.compositing import MIN_WEIGHT, assemble, integrate

FEATURES, HIDDEN, GEOMETRY = 4, 8, 3
REACH = 0.1
"""How strongly the small networks' outputs act on the logarithm of density, and on colour."""

STEPS = 1000


class Driver:
    """One case under the hooks of one plugin.

    Where a field has a grid, the case has numbers for each sample: density and colour are leaf tensors, and two small
    networks from the layer factory change them smoothly with position, direction and distance. While a plugin
    perturbs nothing, rendering again gives the same rendering.

    density: (R, N) and colors: (R, N, 3) the leaves. rendering: of them. broken: what the plugin's contract said
    while it rendered again, by how much at most.
    """

    def __init__(self, inputs: Inputs, hooks: Hooks, plugin: str) -> None:
        self.inputs = inputs
        self.hooks = hooks
        self.plugin = plugin
        self.broken: dict[str, float] = {}
        self.density = inputs.density.clone().requires_grad_()
        self.colors = inputs.colors.clone().requires_grad_()
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(0)
            self.density_network = make_network("density", (FEATURES, HIDDEN, 1 + GEOMETRY), hooks)
            self.color_network = make_network("color", (3 + GEOMETRY, HIDDEN, 3), hooks)
        dtype = single(inputs.density).dtype
        self.density_network.to(dtype)
        self.color_network.to(dtype)
        density = single(self.density)
        result = integrate(density, single(inputs.t_edges))
        colored = result.weights.detach() > MIN_WEIGHT
        with torch.no_grad():
            still, turn = (
                single(inputs.features),
                single(inputs.rays.directions).new_zeros(int(colored.sum()), 3),
            )
            self._raw_density = self.density_network(still.reshape(-1, FEATURES))
            self._raw_color = self.color_network(
                self._color_input(turn, self._raw_density, colored)
            )
        self.rendering = self._composite(density, single(self.colors)[colored], colored)

    @property
    def leaves(self) -> list[Tensor]:
        """Everything that a gradient may reach: density, colours, and the parameters of the networks."""
        return [
            self.density,
            self.colors,
            *self.density_network.parameters(),
            *self.color_network.parameters(),
        ]

    def step(self, fraction: float = 0.5) -> Step:
        """The step at this share of a run of `STEPS`, with randomness that begins anew."""
        return Step(
            index=round(fraction * STEPS),
            total=STEPS,
            fraction=min(fraction, 1.0),
            generator=torch.Generator().manual_seed(0),
            bounds=self.inputs.bounds,
            renderer=self,
        )

    def samples(self) -> Samples:
        """What the hooks get for the rays of the case, (R, N) samples."""
        rays, t = self.inputs.rays, self.inputs.t
        return Samples(
            positions=rays.origins[:, None] + rays.directions[:, None] * t[..., None],
            directions=rays.directions,
            t=t,
            density_width=FEATURES,
            color_width=3,
        )

    def keep_contract(self, step: Step) -> None:
        """Ask the plugin for its contract now, and remember the worst answers."""
        for promise, excess in self.hooks.contract(self.plugin, step).items():
            if math.isnan(excess) or excess > self.broken.get(promise, 0.0):
                self.broken[promise] = excess

    def frozen(self) -> AbstractContextManager[None]:
        """Gradients by the networks' weights are checked too, and never frozen."""
        return nullcontext()

    def render(self, rays: Rays, step: Step, like: Rendering | None = None) -> Rendering:
        """Render the rays of the case again, as the plugin has the networks see them."""
        before = self.samples()
        after = self.hooks.encoder_input(before, step)
        near, far = self.inputs.bounds
        length = far - near if far > near else 1.0
        moved = single(after.positions - before.positions) / length
        later = single(after.t - before.t) / length
        features = single(self.inputs.features) + torch.cat([moved, later[..., None]], dim=-1)
        raw = self.density_network(features.reshape(-1, FEATURES))
        change = (raw - self._raw_density)[:, 0].view(self.density.shape)
        colored = (like or self.rendering).colored
        directions, old = single(after.directions), single(before.directions)
        turned = (directions if directions.ndim == 3 else directions[:, None]) - old[:, None]
        turn = turned.expand(*colored.shape, 3)[colored]
        hue = self.color_network(self._color_input(turn, raw, colored)) - self._raw_color
        colors = single(self.colors)[colored] + REACH * torch.tanh(hue)
        again = self._composite(
            single(self.density) * torch.exp(REACH * torch.tanh(change)), colors, colored
        )
        self.keep_contract(step)
        return again

    def _color_input(
        self,
        turn: Float[Tensor, "colored 3"],
        raw: Float[Tensor, "points out"],
        colored: Bool[Tensor, "rays samples"],
    ) -> Float[Tensor, "colored in"]:
        still = single(self.inputs.features)[colored][:, :3]
        return torch.cat([still + turn, raw[:, 1:][colored.flatten()]], dim=1)

    def _composite(
        self,
        density: Float[Tensor, "rays samples"],
        colors: Float[Tensor, "colored 3"],
        colored: Tensor,
    ) -> Rendering:
        """Composite, and hand out everything in the precision of the case."""
        made = assemble(
            self.inputs.rays,
            single(self.inputs.t),
            single(self.inputs.t_edges),
            density,
            lambda ray, sample: colors,
            colored,
        )
        dtype = self.inputs.density.dtype
        cast: dict[str, Any] = {
            name: part.to(dtype)
            for name, part in vars(made).items()
            if isinstance(part, Tensor) and part.is_floating_point()
        }
        return replace(made, **cast)


def make_network(name: str, widths: tuple[int, ...], hooks: Hooks) -> Network:
    """A network of layers from the layer factory, ReLU between them."""
    last = len(widths) - 2
    layers = [
        hooks.layer(name, i, widths[i], widths[i + 1], "none" if i == last else "relu")
        for i in range(len(widths) - 1)
    ]
    return Network(layers)

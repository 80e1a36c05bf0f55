"""A plugin under check, and the rays of a case rendered through its hooks, as with a field."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import torch
from jaxtyping import Bool, Float
from omegaconf import DictConfig, OmegaConf
from torch import Tensor, nn

from nerfreg.checks.inputs import Inputs, cast
from nerfreg.config.plugin import plugin_config
from nerfreg.field.network import Network
from nerfreg.hooks import Rays, Regularizer, Rendering, Samples, Step
from nerfreg.numerics import single
from nerfreg.registry import Hooks, PluginInfo
from nerfreg.rendering.compositing import assemble

FEATURES, HIDDEN, GEOMETRY = 4, 8, 3
WIDTHS = {"density": (FEATURES, HIDDEN, 1 + GEOMETRY), "color": (3 + GEOMETRY, HIDDEN, 3)}
REACH = 0.1
"""How strongly the small networks act on the logarithm of density, and on colour."""

STEPS = 1000
PROMISE = 1e-6
"""By how much a plugin may break its promises: rounding, which is more in half precision."""


@dataclass(frozen=True)
class Subject:
    """A plugin under check, made anew each time so that no check inherits another's state.

    Attributes:
        name: Name of the plugin.
        hook_points: The hooks by which it takes part in a run.
        config: Its configuration.
        overrides: Those that made the configuration, as given on the command line.
    """

    name: str
    hook_points: tuple[str, ...]
    config: DictConfig
    overrides: tuple[str, ...] = ()

    @classmethod
    def of(cls, plugin: PluginInfo, overrides: Sequence[str] = ()) -> Subject:
        """Return a usable plugin with its defaults changed by overrides `reg.NAME.key=value`."""
        config = plugin_config(plugin, overrides)
        return cls(plugin.name, plugin.hook_points, config, tuple(overrides))

    def hooks(self) -> Hooks:
        """Return the hooks of a run with this plugin alone, of weight 1 and on all the time."""
        plugin = OmegaConf.to_object(self.config)
        assert isinstance(plugin, Regularizer)
        plugin.weight, plugin.start, plugin.end = 1.0, 0.0, 1.0
        return Hooks({self.name: plugin})


class Driver:
    """One case under the hooks of one plugin; renders its rays again for `Step.rerender`.

    Where a field has a grid, the case has numbers for each sample: density and colour are leaf
    tensors, and two small networks from the layer factory change them smoothly with position,
    direction and distance. While a plugin perturbs nothing, rendering again changes nothing.

    Attributes:
        networks: By name, with layers of `WIDTHS`.
        density: (R, N) leaf tensor.
        colors: (R, N, 3) leaf tensor.
        rendering: What the compositor makes of them, in the precision of the case.
        broken: By how much the plugin's promises were broken at most, by name.
    """

    def __init__(self, subject: Subject, inputs: Inputs) -> None:
        self.subject = subject
        self.inputs = inputs
        self.hooks = subject.hooks()
        self.broken: dict[str, float] = {}
        self.density = inputs.density.clone().requires_grad_()
        self.colors = inputs.colors.clone().requires_grad_()
        features = single(inputs.features)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(0)
            self.networks = {name: self._network(name).to(features.dtype) for name in WIDTHS}
        self.rendering = self._assemble(
            single(self.density), lambda ray, sample: single(self.colors)[ray, sample]
        )
        with torch.no_grad():
            self._still = self._evaluate(features, features.new_zeros(3))

    @property
    def leaves(self) -> list[tuple[str, Tensor]]:
        """Everything that a gradient may reach: density, colours, parameters of the networks."""
        networks = self.networks.values()
        parameters = [parameter for network in networks for parameter in network.parameters()]
        own = [("density", self.density), ("rgb", self.colors)]
        return own + [("a parameter of the networks", parameter) for parameter in parameters]

    def step(self, fraction: float = 0.5) -> Step:
        """Return the step at this share of a run, with randomness that begins anew."""
        index, generator = round(fraction * STEPS), torch.Generator().manual_seed(0)
        return Step(index, STEPS, min(fraction, 1.0), generator, self.inputs.bounds, self)

    def samples(self) -> Samples:
        """Return what the hooks get for the rays of the case."""
        rays, t = self.inputs.rays, self.inputs.t
        positions = rays.origins[:, None] + rays.directions[:, None] * t[..., None]
        return Samples(positions, rays.directions, t, density_width=FEATURES, color_width=3)

    def terms(self, step: Step, rendering: Rendering | None = None) -> dict[str, Tensor]:
        """Return the terms of the plugin's loss, of the rendering or of another one."""
        terms = self.hooks.losses(rendering or self.rendering, step)
        return {term.name: term.value for term in terms}

    def reference(
        self, given: nn.Module | Rays | Samples | Rendering, fraction: float = 0.5
    ) -> dict[str, Any]:
        """Return the exact values that the plugin ships for what it makes of `given`."""
        return self.hooks.reference(self.subject.name, given, self.step(fraction))

    def keep_contract(self, step: Step) -> None:
        """Ask the plugin for its contract now, and remember the worst answers."""
        for promise, excess in self.hooks.contract(self.subject.name, step).items():
            if math.isnan(excess) or excess > self.broken.get(promise, 0.0):
                self.broken[promise] = excess

    def broken_promises(self) -> list[str]:
        """Return what the plugin's contract said, as far as it is more than rounding."""
        rounding = max(PROMISE, torch.finfo(self.inputs.density.dtype).eps)
        return [
            f"promise broken: {name}, by {excess:.2g}"
            for name, excess in self.broken.items()
            if not excess <= rounding
        ]

    def frozen(self) -> AbstractContextManager[None]:
        """Freeze nothing: gradients by the networks' weights are checked, too."""
        return nullcontext()

    def render(self, rays: Rays, step: Step, like: Rendering | None = None) -> Rendering:
        """Render the rays of the case again, as the plugin has the networks see them."""
        before = self.samples()
        after = self.hooks.encoder_input(before, step)
        near, far = self.inputs.bounds
        length = far - near if far > near else 1.0
        moved = single(after.positions - before.positions) / length
        later = single(after.t - before.t) / length
        directions, old = single(after.directions), single(before.directions)
        turned = (directions if directions.ndim == 3 else directions[:, None]) - old[:, None]
        features = single(self.inputs.features) + torch.cat([moved, later[..., None]], dim=-1)
        raw, hue = self._evaluate(features, turned)
        change, turn = raw - self._still[0], hue - self._still[1]
        again = self._assemble(
            single(self.density) * torch.exp(REACH * torch.tanh(change[:, 0].view(later.shape))),
            lambda ray, sample: single(self.colors)[ray, sample] + REACH * torch.tanh(turn),
            self.rendering.colored,
        )
        self.keep_contract(step)
        return again

    def _network(self, name: str) -> Network:
        shapes = list(pairwise(WIDTHS[name]))
        activations = [*["relu"] * (len(shapes) - 1), "none"]
        make = enumerate(zip(shapes, activations, strict=True))
        return Network([self.hooks.layer(name, i, *shape, kind) for i, (shape, kind) in make])

    def _evaluate(self, features: Tensor, turned: Tensor) -> tuple[Tensor, Tensor]:
        colored = self.rendering.colored
        raw = self.networks["density"](features.reshape(-1, FEATURES))
        still = single(self.inputs.features)[colored][:, :3]
        seen = still + turned.expand(*colored.shape, 3)[colored]
        return raw, self.networks["color"](torch.cat([seen, raw[:, 1:][colored.flatten()]], dim=1))

    def _assemble(
        self,
        density: Float[Tensor, "rays samples"],
        color: Callable[[Tensor, Tensor], Float[Tensor, "colored 3"]],
        colored: Bool[Tensor, "rays samples"] | None = None,
    ) -> Rendering:
        inputs = self.inputs
        made = assemble(inputs.rays, inputs.t, inputs.t_edges, density, color, colored)
        return cast(made, inputs.density.dtype)

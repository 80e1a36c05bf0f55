"""A plugin under check, and the rays of a case rendered through its hooks, as with a field."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import fields, replace
from itertools import pairwise
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from nerfreg.checks.inputs import Inputs, cast
from nerfreg.checks.report import UnpreparedError
from nerfreg.checks.small_field import FEATURES, SmallField, make_table
from nerfreg.checks.subject import Subject
from nerfreg.errors import NerfregError, PluginError
from nerfreg.field.network import Network
from nerfreg.hooks import ColorSamples, DensitySamples, Rays, Rendering, Samples, Step
from nerfreg.numerics import single
from nerfreg.registry import Hooks
from nerfreg.rendering.compositing import assemble
from nerfreg.scenes.scene import SceneInfo

HIDDEN, GEOMETRY = 8, 3
REACH = 0.1
"""How strongly the small networks act on the logarithm of density, and on colour."""

STEPS = 1000
PROMISE = 1e-6
"""By how much a plugin may break its promises: rounding, which is more in half precision."""

Color = Callable[[Tensor, Tensor], Float[Tensor, "colored 3"]]


class Driver:
    """One case under the hooks of one plugin; renders its rays again for `Step.rerender`.

    Where a field has a grid, the case has numbers for each sample: density and colour are leaf
    tensors, and two small networks from the layer factory change them smoothly with position,
    direction and distance. While a plugin perturbs nothing, rendering again changes nothing. Other
    rays than those of the case are rendered by a small field of the same networks, which is also
    what `Step.field` returns.

    Attributes:
        subject: The plugin.
        hooks: Its hooks.
        inputs: The case, with what the plugin prepared for its pixels.
        scene: What is known of the scene.
        widths: Widths of the layers of each network, by its name.
        networks: By name.
        table: Entries of the small field's grid.
        modules: The modules that the plugin made.
        density: (R, N) leaf tensor.
        colors: (R, N, 3) leaf tensor.
        rendering: What the compositor makes of them, in the precision of the case.
        broken: By how much the plugin's promises were broken at most, by name.
    """

    def __init__(self, subject: Subject, inputs: Inputs, hooks: Hooks | None = None) -> None:
        """Build the networks, and let the plugin prepare.

        Args:
            subject: The plugin.
            inputs: The case.
            hooks: Hooks of the plugin; None: those of a run in which it is on all the time.

        Raises:
            UnpreparedError: The plugin says that it cannot do without the files of a real scene.
        """
        self.subject = subject
        self.hooks = hooks or subject.hooks()
        self.broken: dict[str, float] = {}
        known = (part.name for part in fields(SceneInfo))
        self.scene = SceneInfo(**{name: getattr(inputs.photographs, name) for name in known})
        self.density = inputs.density.clone().requires_grad_()
        self.colors = inputs.colors.clone().requires_grad_()
        features = single(inputs.features)
        self.widths = {
            "density": (FEATURES, HIDDEN, 1 + GEOMETRY),
            "color": (3 + GEOMETRY + self.hooks.color_inputs, HIDDEN, 3),
        }
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(0)
            self.networks = {name: self._network(name).to(features.dtype) for name in self.widths}
            made = self.hooks.modules(self.scene, FEATURES).values()
        self.modules = [trained.module.to(features.dtype) for trained in made]
        # After the modules, as in a run: a plugin may put what it finds out into a buffer.
        self.inputs = self._prepared(inputs)
        self.table = make_table(features.dtype)
        self.rendering = self._assemble(
            self.inputs.rays, single(self.density), lambda *index: single(self.colors)[index]
        )
        with torch.no_grad():
            self._still = self._evaluate(features, features.new_zeros(3), None)
        self.hooks.start(self.step(0.0))

    @property
    def leaves(self) -> list[tuple[str, Tensor]]:
        """Everything that a gradient may reach: density, colours, and all parameters."""
        own = [("density", self.density), ("rgb", self.colors), ("the grid", self.table)]
        names = {
            "a parameter of the networks": self.networks.values(),
            "a parameter of the plugin's module": self.modules,
        }
        return own + [
            (name, parameter)
            for name, parts in names.items()
            for part in parts
            for parameter in part.parameters()
            if parameter.requires_grad
        ]

    def step(self, fraction: float = 0.5) -> Step:
        """Return the step at this share of a run, with randomness that begins anew."""
        return self.step_at(round(fraction * STEPS), STEPS)

    def step_at(self, index: int, total: int) -> Step:
        """Return a step of a run, with randomness that begins anew."""
        fraction, generator = min(index / total, 1.0), torch.Generator().manual_seed(index + 1)
        bounds = self.inputs.bounds
        return Step(index, total, fraction, generator, bounds, self, scene=self.scene)

    def samples(self, rays: Rays | None = None, t: Tensor | None = None) -> Samples:
        """Return what the hooks get for rays; None: those of the case."""
        rays, t = rays or self.inputs.rays, self.inputs.t if t is None else t
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
        if self.subject.name not in self.hooks.plugins:
            return
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

    def cast(self, rays: Rays, step: Step) -> Rays:
        """Return the rays as the plugin changes them."""
        return self.hooks.rays(rays, step)

    def frozen(self) -> AbstractContextManager[None]:
        """Freeze nothing: gradients by the networks' weights are checked, too."""
        return nullcontext()

    def view(self, step: Step) -> SmallField:
        """Return a small field of the networks."""
        return SmallField(self.table, self.networks, self.scene, self.hooks.color_inputs)

    def render(
        self,
        rays: Rays,
        step: Step,
        like: Rendering | None = None,
        shift: Float[Tensor, "rays samples 3"] | None = None,
        density_only: bool = False,
    ) -> Rendering:
        """Render rays as the plugin has the networks see them.

        Those of the case have its density and colours, which the networks change; all others have
        those of the small field.
        """
        own = like is not None and like.t.shape == self.inputs.t.shape
        edges = self._even_edges(rays) if like is None else like.t_edges
        t = (edges[:, 1:] + edges[:, :-1]) / 2 if like is None else like.t
        before = self.samples(rays, t)
        if shift is not None:
            before = replace(before, positions=before.positions + shift)
        after = self.hooks.encoder_input(before, step)
        density, raw, hue = (self._of_case if own else self._of_field)(after, rays, step)
        positions = single(after.positions).flatten(0, 1)
        if (empty := self.hooks.empty(positions.detach(), step)) is not None:
            density = torch.where(empty.view(density.shape), 0.0, density)
        if self.hooks.changes("nerfreg_density", step):
            samples = DensitySamples(rays, t, edges, density, lambda: raw)
            density = self.hooks.density(samples, step)
        colored = like.colored if own and like is not None else None
        made = self._assemble(rays, density, hue, colored, t, edges)
        if density_only:
            made = replace(made, rgb=torch.full_like(made.rgb, torch.nan))
        made = self.hooks.rendering(made, step)
        self.keep_contract(step)
        return made

    def _prepared(self, inputs: Inputs) -> Inputs:
        try:
            prepared = self.hooks.prepare(inputs.photographs)
        except PluginError:
            raise
        except NerfregError as error:
            # The plugin's own words: it misses a file, for example, that no made-up scene has.
            raise UnpreparedError(f"nerfreg_prepare: {error}") from error
        return inputs.with_data(prepared) if prepared else inputs

    def _even_edges(self, rays: Rays) -> Float[Tensor, "rays edges"]:
        share = torch.linspace(0, 1, self.inputs.t.shape[1] + 1).to(rays.near)
        return torch.lerp(rays.near[:, None], rays.far[:, None], share)

    def _network(self, name: str) -> Network:
        shapes = list(pairwise(self.widths[name]))
        activations = [*["relu"] * (len(shapes) - 1), "none"]
        make = enumerate(zip(shapes, activations, strict=True))
        return Network([self.hooks.layer(name, i, *shape, kind) for i, (shape, kind) in make])

    def _of_case(self, after: Samples, rays: Rays, step: Step) -> tuple[Tensor, Tensor, Color]:
        """Density, raw density and colours of the case, changed by where its samples are now."""
        before = self.samples()
        near, far = self.inputs.bounds
        length = far - near if far > near else 1.0
        moved = single(after.positions - before.positions) / length
        later = single(after.t - before.t) / length
        directions, old = single(after.directions), single(before.directions)
        turned = (directions if directions.ndim == 3 else directions[:, None]) - old[:, None]
        features = single(self.inputs.features) + torch.cat([moved, later[..., None]], dim=-1)
        index = self.rendering.colored.nonzero(as_tuple=True)
        raw, hue = self._evaluate(features, turned, self._color_input(rays, after.t, index, step))
        change, turn = raw - self._still[0], hue - self._still[1]
        factor = torch.exp(REACH * torch.tanh(change[:, 0].view(later.shape)))

        def color(ray: Tensor, sample: Tensor) -> Tensor:
            return single(self.colors)[ray, sample] + REACH * torch.tanh(turn)

        return single(self.density) * factor, raw[:, 0].view(later.shape), color

    def _of_field(self, after: Samples, rays: Rays, step: Step) -> tuple[Tensor, Tensor, Color]:
        """Density, raw density and colours of the small field."""
        field, shape = self.view(step), after.t.shape
        raw = field.raw(after.positions.flatten(0, 1))
        turned = after.directions if after.directions.ndim == 3 else after.directions[:, None]
        directions = single(turned).expand(*shape, 3)

        def color(ray: Tensor, sample: Tensor) -> Tensor:
            more = self._color_input(rays, after.t, (ray, sample), step)
            geometry = raw[:, 1:].view(*shape, -1)[ray, sample]
            return field.color_of(geometry, directions[ray, sample], more)

        return field.activate(raw[:, 0]).view(shape), raw[:, 0].view(shape), color

    def _color_input(
        self, rays: Rays, t: Tensor, index: tuple[Tensor, ...], step: Step
    ) -> Tensor | None:
        if not self.hooks.color_inputs:
            return None
        return self.hooks.color_input(ColorSamples(rays, index[0], t[index]), step)

    def _evaluate(
        self, features: Tensor, turned: Tensor, more: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        colored = self.rendering.colored
        # Layers may draw from the global generator, as torch's dropout does.
        with torch.random.fork_rng(devices=[]):
            raw = self.networks["density"](features.reshape(-1, FEATURES))
            seen = single(self.inputs.features)[colored][:, :3]
            seen = seen + turned.expand(*colored.shape, 3)[colored]
            if more is None:
                more = seen.new_zeros(len(seen), self.hooks.color_inputs)
            inputs = [seen, raw[:, 1:][colored.flatten()], more.to(raw.dtype)]
            return raw, self.networks["color"](torch.cat(inputs, dim=1))

    def _assemble(
        self,
        rays: Rays,
        density: Float[Tensor, "rays samples"],
        color: Color,
        colored: Bool[Tensor, "rays samples"] | None = None,
        t: Float[Tensor, "rays samples"] | None = None,
        edges: Float[Tensor, "rays edges"] | None = None,
    ) -> Rendering:
        inputs = self.inputs
        t, edges = inputs.t if t is None else t, inputs.t_edges if edges is None else edges
        return cast(assemble(rays, t, edges, density, color, colored), inputs.density.dtype)

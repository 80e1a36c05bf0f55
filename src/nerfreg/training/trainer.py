"""One training step, and everything that a step needs."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg.field import FieldConfig, RadianceField
from nerfreg.hooks import Rendering, Step
from nerfreg.rays import RayBatches
from nerfreg.registry import Hooks, Term
from nerfreg.rendering.config import SamplerConfig
from nerfreg.rendering.renderer import Renderer
from nerfreg.scenes.scene import Scene
from nerfreg.training.averaging import MovingAverage
from nerfreg.training.budget import Budget
from nerfreg.training.config import OptimConfig, TrainConfig

COLOR = "color"
"""Name of the loss term that every run has: the mean squared error of the colours."""


class Trainer:
    """Trains a field on a scene under the plugins of `hooks`.

    Randomness comes from the seed alone: the same seed, machine and number of threads give the same weights.
    """

    def __init__(
        self,
        scene: Scene,
        hooks: Hooks,
        field: FieldConfig,
        sampler: SamplerConfig,
        optim: OptimConfig,
        train: TrainConfig,
        seed: int = 0,
        device: torch.device | None = None,
    ) -> None:
        device = device or torch.device("cpu")
        torch.manual_seed(seed)
        self.scene = scene
        self.hooks = hooks
        self.optim = optim
        self.generator = torch.Generator().manual_seed(seed)
        self.field = RadianceField(field, scene.box, hooks.layer).to(device)
        self.renderer = Renderer(self.field, sampler, hooks)
        self.batches = RayBatches(scene, train.rays, device, self.generator)
        self.optimizer = torch.optim.Adam(
            self.field.parameters(), lr=optim.lr, betas=(optim.beta1, optim.beta2), eps=optim.eps, fused=True
        )
        self.average = MovingAverage(self.field, optim.ema)
        self.budget = Budget(train)
        self.warm_up()

    def warm_up(self) -> None:
        """Compile what a step runs, so that no step has to wait for it."""
        probe = self.scene.box.mean(dim=0).to(self.field.center).expand(8, 3).requires_grad_()
        self.field.raw_density(probe).sum().backward()
        self.field.zero_grad(set_to_none=True)

    def step(self) -> list[Term]:
        """Train one step; returns the terms of its loss, unweighted."""
        with self.budget.spend():
            step = self._step()
            rays = self.batches.draw(self.hooks.needs(step))
            rendering = self.renderer.render(rays, step)
            terms = [Term(COLOR, COLOR, 1.0, color_error(rendering)), *self.hooks.losses(rendering, step)]
            total = torch.stack([term.weight * term.value for term in terms]).sum()
            self.optimizer.zero_grad(set_to_none=True)
            total.backward()
            for group in self.optimizer.param_groups:
                group["lr"] = self.optim.lr * self.optim.decay**step.fraction
            self.optimizer.step()
            self.average.update()
            return [Term(term.plugin, term.name, term.weight, term.value.detach()) for term in terms]

    def _step(self) -> Step:
        step = Step(
            index=self.budget.step,
            total=self.budget.total,
            fraction=self.budget.fraction,
            generator=self.generator,
            bounds=(self.scene.near, self.scene.far),
            rerender=lambda rendering: self.renderer.rerender(rendering, step),
        )
        return step


def color_error(rendering: Rendering) -> Float[Tensor, ""]:
    """Mean squared error of the rays that have a target, weighted by `Rays.target_weights`."""
    rays = rendering.rays
    errors = (rendering.rgb[: len(rays.targets)] - rays.targets).square().mean(dim=1)
    return errors.mean() if rays.target_weights is None else (rays.target_weights * errors).mean()

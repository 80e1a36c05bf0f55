"""One training step, and everything that a step needs."""

from __future__ import annotations

import torch

from nerfreg.errors import NerfregError
from nerfreg.field import FieldConfig, RadianceField
from nerfreg.hooks import Step
from nerfreg.rays import RayBatches
from nerfreg.rays.batch import Batch
from nerfreg.registry import Hooks, Term
from nerfreg.rendering.config import SamplerConfig
from nerfreg.rendering.renderer import Renderer
from nerfreg.scenes.scene import Scene
from nerfreg.training.averaging import MovingAverage
from nerfreg.training.budget import Budget
from nerfreg.training.config import OptimConfig, TrainConfig
from nerfreg.training.faults import usable
from nerfreg.training.guard import Guard
from nerfreg.training.loss import loss_terms, total_loss


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
        guard: Guard | None = None,
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
            self.field.parameters(),
            lr=optim.lr,
            betas=(optim.beta1, optim.beta2),
            eps=optim.eps,
            fused=True,
        )
        self.average = MovingAverage(self.field, optim.ema)
        self.budget = Budget(train)
        self.guard = guard or Guard()
        self.warm_up()
        with self.budget.prepare():
            self.batches.known_depth = hooks.known_depth(self.batches.photographs)
        if self.budget.fraction >= 1:
            raise NerfregError(
                f"train.seconds={train.seconds:g}: was spent before the first step, "
                f"on {self.budget.seconds:.1f} s of what the plugins do beforehand; give more"
            )

    def warm_up(self) -> None:
        """Compile what a step runs, so that no step has to wait for it."""
        probe = self.scene.box.mean(dim=0).to(self.field.center).expand(8, 3).requires_grad_()
        self.field.raw_density(probe).sum().backward()
        self.field.zero_grad(set_to_none=True)

    def step(self) -> list[Term]:
        """Train one step; returns the terms of its loss, unweighted.

        A loss or gradient that is not finite changes neither the weights nor what Adam and the moving average
        remember. Raises NonFiniteError if that happens three times in a row.
        """
        with self.budget.spend():
            step = self._step()
            batch = Batch.of(self.batches.draw(self.hooks.needs(step)), step)
            terms = loss_terms(batch.render(), self.hooks, step)
            total = total_loss(terms)
            self.optimizer.zero_grad(set_to_none=True)
            total.backward()
            finite = usable(total.detach(), self.field.parameters())
            if finite:
                self._apply(step)
        terms = [Term(term.plugin, term.name, term.weight, term.value.detach()) for term in terms]
        if finite:
            self.guard.passed()
        else:
            self.optimizer.zero_grad(set_to_none=True)
            again = Renderer(self.field, self.renderer.sampler, self.hooks)
            self.guard.refused(batch, terms, again, self.hooks, self.scene.box)
        return terms

    def _apply(self, step: Step) -> None:
        # Nothing has to be looked at after this: see OptimConfig for why Adam makes finite weights of such gradients.
        for group in self.optimizer.param_groups:
            group["lr"] = self.optim.rate(step.fraction, step.total)
        self.optimizer.step()
        self.average.update()

    def _step(self) -> Step:
        return Step(
            index=self.budget.step,
            total=self.budget.total,
            fraction=self.budget.fraction,
            generator=self.generator,
            bounds=(self.scene.near, self.scene.far),
            renderer=self.renderer,
        )

"""One training step, and everything that a step needs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import torch
from torch import nn

from nerfreg.errors import NerfregError
from nerfreg.field import FieldConfig
from nerfreg.hooks import Step, TrainedModule
from nerfreg.rays import RayBatches
from nerfreg.rays.batch import Batch
from nerfreg.registry import Hooks, Term
from nerfreg.registry.field import make_field
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
    """Trains a field on a scene.

    The same seed, machine and number of threads give the same weights.

    Attributes:
        scene: The scene.
        hooks: The hooks of the active plugins.
        optim: Options of the optimizer.
        generator: The run's source of randomness, on the CPU.
        field: The field that is trained.
        renderer: Renders the rays of each step.
        batches: Draws the rays of each step.
        optimizer: Adam.
        average: Moving average of the weights.
        budget: How much of the run is done.
        guard: Counts and reports steps that were left out.
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
        """Build the field, and let the plugins prepare.

        Args:
            scene: The scene.
            hooks: The hooks of the active plugins.
            field: Options of the field.
            sampler: Options of the sampler.
            optim: Options of the optimizer.
            train: The budget.
            seed: Seed of all randomness.
            device: Where the field is trained; None: on the CPU.
            guard: Treats steps that are not finite; None: reports them and saves none.

        Raises:
            NerfregError: The budget has no end, or preparation has spent all of it.
        """
        device = device or torch.device("cpu")
        # Layers are initialized from PyTorch's global generator, all else is drawn from ours.
        torch.manual_seed(seed)
        self.scene = scene
        self.hooks = hooks
        self.optim = optim
        self.generator = torch.Generator().manual_seed(seed)
        self.field = make_field(field, scene.info, hooks).to(device).train()
        self.renderer = Renderer(self.field, sampler, hooks)
        self.batches = RayBatches(scene, train.rays, device, self.generator)
        own, of_plugins = self._parameters()
        # Fused: one pass over weights, gradient and moments, since memory bandwidth limits it.
        self.optimizer = torch.optim.Adam(
            [{"params": own}, *({"params": parameters} for parameters in of_plugins.values())],
            lr=optim.lr,
            betas=(optim.beta1, optim.beta2),
            eps=optim.eps,
            fused=True,
        )
        latest = [
            parameter
            for name, parameters in of_plugins.items()
            if not self.field.trained[name].averaged
            for parameter in parameters
        ]
        self.average = MovingAverage(self.field, optim.ema, latest)
        self.budget = Budget(train)
        self.guard = guard or Guard()
        self.warm_up()
        # What a plugin finds out about the photographs before the first step is training time.
        with self.budget.prepare():
            photographs = self.batches.photographs
            self.batches.known_depth = hooks.known_depth(photographs)
            photographs = replace(photographs, known_depth=self.batches.known_depth)
            self.batches.data = hooks.prepare(photographs)
            step = self._step()
            hooks.begin(step)
            hooks.start(step)
            for grid in hooks.occupancy(step):
                self.batches.keep_what_meets(grid)
        if self.budget.fraction >= 1:
            raise NerfregError(
                f"train.seconds={train.seconds:g}: was spent before the first step, because the "
                f"plugins prepared for {self.budget.seconds:.1f} s; set a larger value"
            )

    def warm_up(self) -> None:
        """Compile what a step runs, so that no step has to wait for it."""
        # A gradient of the positions is asked for, so that the kernels for it are compiled too.
        probe = self.scene.box.mean(dim=0).to(self.field.center).expand(8, 3).requires_grad_()
        self.field.raw_density(probe).sum().backward()
        self.field.zero_grad(set_to_none=True)

    def step(self) -> list[Term]:
        """Train one step.

        If the loss or a gradient is not finite, the step changes neither the weights nor the state
        of Adam and the moving average.

        Returns:
            The terms of the loss, unweighted and detached.

        Raises:
            NonFiniteError: This was the third step in a row that was not finite.
        """
        with self.budget.spend():
            step = self._step()
            self.hooks.begin(step)
            try:
                batch, terms, finite = self._forth_and_back(step)
                if finite:
                    self._apply(step)
                    self.hooks.step_end(step)
            except Exception as error:
                blamed = self.hooks.blamed(error, step)
                if blamed is error:
                    raise
                raise blamed from error
        # Detached, so that whoever keeps the terms does not keep the graph of the step.
        terms = [Term(term.plugin, term.name, term.weight, term.value.detach()) for term in terms]
        if finite:
            self.guard.passed()
        else:
            self.optimizer.zero_grad(set_to_none=True)
            # Another renderer, because rendering to find the fault is no training and must not add
            # to `renderer.points`. It also stays outside of the budget's clock.
            again = Renderer(self.field, self.renderer.sampler, self.hooks)
            self.guard.refused(batch, terms, again, self.hooks, self.scene.box)
        return terms

    def end(self) -> None:
        """Tell the plugins that the last step has been made."""
        with self.budget.prepare():
            self.hooks.end(self._step())

    @contextmanager
    def evaluated(self) -> Iterator[Step]:
        """Within this context, the field is in evaluation and has its averaged weights.

        Yields:
            Where the run stands, for the hooks that are called in evaluation.
        """
        # A generator of its own, so that evaluation does not change the run.
        generator = torch.Generator().manual_seed(0)
        step = replace(self._step(), generator=generator, training=False, averaged=None)
        self.hooks.begin(step)
        self.field.eval()
        try:
            with self.average.applied():
                yield step
        finally:
            self.field.train()

    def _forth_and_back(self, step: Step) -> tuple[Batch, list[Term], bool]:
        """Render the rays of a step, and differentiate its loss."""
        needs = self.hooks.needs(step)
        choose = (
            partial(self.hooks.unseen_poses, step, self.scene.info)
            if self.hooks.changes("nerfreg_unseen_poses", step)
            else None
        )
        batch = Batch.of(self.batches.draw(needs, choose), step)
        terms = loss_terms(batch.render(), self.hooks, step)
        total = total_loss(terms)
        # Gradients are set to None and not to 0, so that a parameter that is not used in this step
        # costs nothing.
        self.optimizer.zero_grad(set_to_none=True)
        total.backward()
        return batch, terms, usable(total.detach(), self.field.parameters())

    def _apply(self, step: Step) -> None:
        # The weights need no test after this: see OptimConfig for why gradients whose squares are
        # finite cannot make a weight that is not.
        rate = self.optim.rate(step.fraction, step.total)
        settings = [TrainedModule(self.field), *self.field.trained.values()]
        for group, trained in zip(self.optimizer.param_groups, settings, strict=True):
            own = trained.schedule
            base = rate if own is None else self.optim.lr * own.at(step.fraction)
            group["lr"] = base * trained.lr_scale
            if trained.weight_decay and group["params"]:
                torch._foreach_mul_(
                    [p.detach() for p in group["params"]], 1 - group["lr"] * trained.weight_decay
                )
        self.optimizer.step()
        self.average.update()

    def _parameters(self) -> tuple[list[nn.Parameter], dict[str, list[nn.Parameter]]]:
        """The parameters of the field, and those of the modules of plugins by plugin."""
        of_plugins = {
            name: [*trained.module.parameters()] for name, trained in self.field.trained.items()
        }
        taken = {id(parameter) for part in of_plugins.values() for parameter in part}
        return [p for p in self.field.parameters() if id(p) not in taken], of_plugins

    def _step(self) -> Step:
        return Step(
            index=self.budget.step,
            total=self.budget.total,
            fraction=self.budget.fraction,
            generator=self.generator,
            bounds=(self.scene.near, self.scene.far),
            renderer=self.renderer,
            scene=self.scene.info,
            averaged=self.average.applied,
        )

"""A field in evaluation, with the plugins that still act on it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from nerfreg.field import RadianceField
from nerfreg.hooks import EvaluatedView, Step
from nerfreg.registry import Hooks
from nerfreg.rendering.config import SamplerConfig
from nerfreg.rendering.views import ViewRenderer
from nerfreg.scenes.scene import Scene
from nerfreg.training.trainer import Trainer


@dataclass(frozen=True)
class TrainedField:
    """A field whose views can be rendered.

    Attributes:
        field: The field, with the weights to evaluate.
        hooks: The hooks of its run.
        step: Where the run stood, in evaluation.
        sampler: Numbers of samples.
        scene: The scene.
    """

    field: RadianceField
    hooks: Hooks
    step: Step
    sampler: SamplerConfig
    scene: Scene

    def renderer(self) -> ViewRenderer:
        """Return a renderer of views, for the weights that the field has now."""
        return ViewRenderer(self.field, self.sampler, self.scene, self.hooks, self.step)

    def measure(self, view: EvaluatedView) -> dict[str, float]:
        """Return what plugins measure of a rendered view, by "plugin.metric"."""
        return self.hooks.metrics(view, self.step)


@contextmanager
def evaluated(trainer: Trainer) -> Iterator[TrainedField]:
    """Within this context, the field of a trainer is in evaluation, with its averaged weights."""
    with trainer.evaluated() as step:
        sampler = trainer.renderer.sampler
        yield TrainedField(trainer.field, trainer.hooks, step, sampler, trainer.scene)

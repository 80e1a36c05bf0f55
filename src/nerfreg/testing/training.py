"""A short training of a small scene with a plugin that nothing has installed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property

from nerfreg.errors import NerfregError
from nerfreg.evaluation.scores import Scores, score_views
from nerfreg.evaluation.trained import evaluated
from nerfreg.field import FieldConfig, RadianceField
from nerfreg.hooks import Regularizer
from nerfreg.rendering.config import SamplerConfig
from nerfreg.scenes import Scene
from nerfreg.scenes.procedural import Procedural
from nerfreg.testing.losses import Loss, as_plugin, name_of
from nerfreg.training.checked_hooks import CheckedHooks
from nerfreg.training.config import OptimConfig, TrainConfig
from nerfreg.training.guard import Guard
from nerfreg.training.loss import label
from nerfreg.training.trainer import Trainer

FIELD = FieldConfig(levels=4, finest=64, log2_entries=12)
SAMPLER = SamplerConfig(coarse=16, fine=16, skip_resolution=32)
RAYS = 128


@dataclass
class ShortRun:
    """A finished training.

    Attributes:
        trainer: What has trained, with its hooks, optimizer and moving average.
        terms: The loss of each step: the unweighted value of each term, "color" among them, by the
            name that it has in reports.
    """

    trainer: Trainer
    terms: list[dict[str, float]] = field(repr=False)

    @property
    def field(self) -> RadianceField:
        """The trained field, with its latest weights."""
        return self.trainer.field

    @property
    def scene(self) -> Scene:
        """The scene."""
        return self.trainer.scene

    def values(self, term: str) -> list[float]:
        """Return the values of one term, of those steps that have it.

        Raises:
            NerfregError: No step has it.
        """
        found = [terms[term] for terms in self.terms if term in terms]
        if not found:
            known = sorted({name for terms in self.terms for name in terms})
            raise NerfregError(f"no step has a term '{term}'; there are {', '.join(known)}")
        return found

    @cached_property
    def scores(self) -> Scores:
        """Scores of the test views at full size, with averaged weights and without LPIPS.

        What plugins measure themselves is in `metrics`, by "plugin.metric".
        """
        scene = self.scene
        with evaluated(self.trainer) as trained:
            renderer = trained.renderer()
            return score_views(
                scene,
                scene.test,
                lambda view: renderer.view(scene.cameras, view),
                None,
                measure=trained.measure,
            )


def run_steps(
    plugin: Loss | Mapping[str, Loss] | None,
    steps: int = 20,
    scene: Scene | None = None,
    seed: int = 0,
) -> ShortRun:
    """Train a small field for some steps, and look at everything that the plugins return.

    A step takes some milliseconds. Fields that depend on the layout of the cameras
    (`Regularizer.by_layout`) stay as they are.

    Args:
        plugin: A plugin, a function of what a rendering has, several of them by name, or None for
            a run without any, to compare with.
        steps: Number of steps, which is the budget that schedules and windows follow.
        scene: The scene; None: `small_scene()`.
        seed: Seed of all randomness. The same seed gives the same weights.

    Raises:
        AssertionError: A gradient is not finite in a step; names it.
        NerfregError: A plugin returns what it must not, such as a term that is not finite; names
            the hook and the step.
    """
    trainer = Trainer(
        small_scene() if scene is None else scene,
        CheckedHooks(_named(plugin)),
        FIELD,
        SAMPLER,
        OptimConfig(),
        TrainConfig(steps=steps, rays=RAYS),
        seed,
        guard=Guard(report=_refuse),
    )
    record = []
    while trainer.budget.fraction < 1:
        record.append({label(term): term.value.item() for term in trainer.step()})
    trainer.end()
    return ShortRun(trainer, record)


@cache
def small_scene() -> Scene:
    """Return solids in three training views and a test view of 24 x 24 pixels, made once."""
    return Procedural(views=3, test_views=1, size=24).load()


def _named(plugin: Loss | Mapping[str, Loss] | None) -> dict[str, Regularizer]:
    if plugin is None:
        return {}
    if isinstance(plugin, Mapping):
        return {name: as_plugin(part) for name, part in plugin.items()}
    one = as_plugin(plugin)
    return {name_of(one): one}


def _refuse(line: str) -> None:
    raise AssertionError(f"expected a finite step, found {line}")

"""The base class of all plugins, and what a plugin may add to a field."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from torch import nn

from nerfreg.hooks.schedule import Schedule
from nerfreg.hooks.step import Step

HOOKS_VERSION = 2
"""Version of the hook specifications."""

CHANGED: dict[int, tuple[str, ...]] = {2: ()}
"""The hooks whose specification changed with a version, so that what was written for an earlier one
must be looked at. New hooks change nothing for those who do not use them."""


@dataclass(frozen=True)
class TrainedModule:
    """A module of a plugin with settings for its training, for `nerfreg_module`.

    Attributes:
        module: The module.
        lr_scale: Factor of the run's learning rate for its parameters.
        weight_decay: Decoupled weight decay: each step multiplies weights by 1 - rate * this.
        schedule: Factor of `optim.lr` over the run, in place of the run's own decay; None keeps it.
        averaged: Whether evaluation uses the moving average of its parameters; False: the latest.
    """

    module: nn.Module
    lr_scale: float = 1.0
    weight_decay: float = 0.0
    schedule: Schedule | None = None
    averaged: bool = True


@dataclass
class Regularizer:
    """Base of all plugins: a dataclass whose fields are the plugin's configuration.

    Class variables are no configuration. All of them are optional:

    - `by_layout` maps a kind of capture ("forward", "object", "room", or "orbit" for both of these)
      to defaults that differ there, such as `{"forward": {"weight": 2e-5}}`; they hold wherever the
      user says nothing.
    - `conflicts` names plugins that cannot be active in the same run.
    - `cite` gives the sources for `nerfreg cite`: BibTeX text, or keys, separated by commas, of
      entries in a file `references.bib` in the package of the plugin's module or the closest parent
      package that has one.
    - `schedulable` names numeric fields, besides `weight`, that may be given a schedule; the core
      sets them before each step.
    - `in_evaluation` names those of `nerfreg_rays`, `nerfreg_encoder_input`, `nerfreg_density` and
      `nerfreg_rendering` that are to be called in evaluation, too.
    - `evaluation_note` is a sentence that stands beside the scores of a run with this plugin.
    - `hook_versions` is the first and the last version of the hook specifications for which the
      plugin was written (`nerfreg.hooks.HOOKS_VERSION`).
    - `instance` is what the plugin is called in its run. The core sets it; it differs from the
      plugin's name where one is selected twice.

    Attributes:
        weight: Factor of every term that `nerfreg_loss` returns; 0 switches the plugin off at no
            cost.
        start: When the plugin becomes active: a step (integer) or a fraction of the budget (0.0 to
            1.0).
        end: When it ceases to be active, likewise.
    """

    weight: float = 1.0
    start: int | float = 0.0
    end: int | float = 1.0

    by_layout: ClassVar[dict[str, dict[str, Any]]] = {}
    conflicts: ClassVar[tuple[str, ...]] = ()
    cite: ClassVar[str] = ""
    schedulable: ClassVar[tuple[str, ...]] = ()
    in_evaluation: ClassVar[tuple[str, ...]] = ()
    evaluation_note: ClassVar[str] = ""
    hook_versions: ClassVar[tuple[int, int] | None] = None
    # Set on an instance by the configuration; a field could not be typed for Hydra.
    schedules: ClassVar[Mapping[str, Schedule]] = MappingProxyType({})
    instance: ClassVar[str] = ""

    @property
    def scale_free(self) -> bool:
        """Whether the loss stays the same when all distances grow by a factor.

        `nerfreg check` verifies the claim.
        """
        return False

    @property
    def color_inputs(self) -> int:
        """How many features `nerfreg_color_input` adds to the input of the colour network."""
        return 0

    def active(self, step: Step) -> bool:
        """Return whether `step` lies in [start, end); the last step belongs to `end: 1.0`."""
        begun = (
            step.index >= self.start if isinstance(self.start, int) else step.fraction >= self.start
        )
        if isinstance(self.end, int):
            return begun and step.index < self.end
        return begun and (step.fraction < self.end or self.end >= 1.0)

    def follow_schedules(self, step: Step) -> None:
        """Set the fields that have a schedule to their values in this step."""
        for name, schedule in self.schedules.items():
            setattr(self, name, schedule.at(step.fraction))

    def state_dict(self) -> dict[str, Any]:
        """Return what the plugin has learned besides the parameters of its module and layers.

        It is saved with the checkpoint, and given to `load_state_dict` when a run is evaluated,
        rendered or resumed. Overridden by plugins that keep state.

        Returns:
            Tensors, numbers, strings and booleans, None, and lists and dictionaries (by strings) of
            these.
        """
        return {}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` returned.

        Args:
            state: The same values; tensors are on the CPU.
        """

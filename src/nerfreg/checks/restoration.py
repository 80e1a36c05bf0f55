"""Whether a checkpoint holds all that a plugin has learned."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor, nn

from nerfreg.hooks import Regularizer, Step
from nerfreg.rays.batch import Batch
from nerfreg.training.checkpoint import State, load_checkpoint, save_checkpoint
from nerfreg.training.loss import label, loss_terms
from nerfreg.training.trainer import Trainer

ALIKE = 1e-5
"""Largest relative difference of the next step with everything restored."""


def unsaved_parameters(plugin: Regularizer, field: nn.Module) -> list[str]:
    """Return a line for each attribute of a plugin with parameters that no checkpoint holds.

    Args:
        plugin: The plugin.
        field: The field, with the modules and layers that the plugin has made for it.
    """
    known = {id(parameter) for parameter in field.parameters()}
    shapes = {tuple(tensor.shape) for tensor in _tensors(plugin.state_dict())}
    lines = []
    for name, value in vars(plugin).items():
        stray = [
            parameter
            for parameter in _parameters(value)
            # What needs no gradient is no parameter, but a network made elsewhere, for example.
            if parameter.requires_grad and id(parameter) not in known
        ]
        if any(tuple(parameter.shape) not in shapes for parameter in stray):
            lines.append(
                f"self.{name}: {len(stray)} parameters that are neither trained nor saved; "
                "return the module from nerfreg_module"
            )
    return lines


def wrong_restoration(trainer: Trainer, other: Trainer, folder: Path) -> list[str]:
    """Compare the next step of a trainer with that of another one that its checkpoint restores.

    Args:
        trainer: Has trained.
        other: The same, before its first step.
        folder: Where the checkpoint goes.
    """
    state = State(trainer.budget.step, 0.0, 0, fraction=1.0, plugins=trainer.hooks.state_dict())
    save_checkpoint(folder, trainer.field, state)
    other.hooks.load_state_dict(load_checkpoint(folder, other.field).plugins)
    with torch.no_grad():
        for average, known in zip(other.average.averages, trainer.average.averages, strict=True):
            average.copy_(known)
    with trainer.evaluated() as evaluated:
        step = replace(evaluated, training=True)
    rays = trainer.batches.draw(trainer.hooks.needs(_step(step, trainer)))
    values = [_next(Batch.of(rays, _step(step, each)), each) for each in (trainer, other)]
    return [
        f"{name} of the next step is {_mean(a)}, and {_mean(b)} with everything restored from the "
        "checkpoint; return what it depends on from state_dict and take it back in load_state_dict,"
        " or keep it in the module of nerfreg_module"
        for name, (a, b) in _pairs(*values)
        if not torch.allclose(a, b, rtol=ALIKE, atol=ALIKE * float(a.abs().max()))
    ]


def _mean(values: Tensor) -> str:
    return f"{float(values.double().mean()):.6g}"


def _step(step: Step, trainer: Trainer) -> Step:
    generator = torch.Generator().manual_seed(1)
    averaged = trainer.average.applied
    return replace(step, generator=generator, renderer=trainer.renderer, averaged=averaged)


def _next(batch: Batch, trainer: Trainer) -> dict[str, Tensor]:
    """What a step returns: colours, and terms by name."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        trainer.hooks.begin(batch.step)
        rendering = batch.render()
        terms = loss_terms(rendering, trainer.hooks, batch.step)
    found = {f"term '{label(term)}'": term.value.detach() for term in terms}
    return {"the colour": rendering.rgb.detach(), **found}


def _pairs(
    first: Mapping[str, Tensor], second: Mapping[str, Tensor]
) -> Iterator[tuple[str, tuple[Tensor, Tensor]]]:
    for name, value in first.items():
        # A term that is not there any more counts as 0.
        yield name, (value, second.get(name, torch.zeros_like(value)))


def _parameters(value: object) -> Iterator[nn.Parameter]:
    if isinstance(value, nn.Parameter):
        yield value
    elif isinstance(value, nn.Module):
        yield from value.parameters()
    elif isinstance(value, Mapping | list | tuple):
        for part in value.values() if isinstance(value, Mapping) else value:
            yield from _parameters(part)


def _tensors(state: object) -> Iterator[Tensor]:
    if isinstance(state, Tensor):
        yield state
    elif isinstance(state, Mapping | list):
        for part in state.values() if isinstance(state, Mapping) else state:
            yield from _tensors(part)

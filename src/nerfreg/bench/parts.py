"""The parts of a training step, and how long each takes, forward and backward."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import fields, is_dataclass
from inspect import isfunction
from statistics import mean
from typing import Any

from torch import Tensor
from torch.autograd.graph import Node

from nerfreg.bench.configured import step_at
from nerfreg.bench.stopwatch import Stopwatch
from nerfreg.hooks import Rendering, Step
from nerfreg.registry import Hooks, Term
from nerfreg.rendering import renderer, sampling
from nerfreg.training import loss
from nerfreg.training.trainer import Trainer

GRID, NETWORKS, COMPOSITING = "hash grid", "networks", "compositing"
RAYS, HOOKS, SAMPLING, OPTIMIZER, AVERAGE = (
    "rays",
    "hooks",
    "sampling",
    "optimizer",
    "moving average",
)
COLOR_LOSS = "color loss"
BACKWARD = " backward"
"""Ends the name of a part's backward pass."""
REST = "rest"
"""What belongs to no part: zeroing, checks, and what autograd does between the parts, such as adding up gradients."""


def measure_parts(trainer: Trainer, at: float, steps: int) -> dict[str, float]:
    """Milliseconds of each part of a step at share `at` of the budget; they add up to a whole step.

    The mean over the middle half of `steps` steps, so that a disturbed one counts for nothing.
    """
    watch = Stopwatch()
    taken = []
    with timed_parts(trainer, watch):
        for _ in range(steps):
            with watch.part(REST):
                step_at(trainer, at)
            taken.append(watch.take())
    return {part: 1e3 * seconds for part, seconds in middle_mean(taken).items()}


def middle_mean(taken: Sequence[dict[str, float]]) -> dict[str, float]:
    """The mean by part over those whose sum is in the middle half."""
    ordered = sorted(taken, key=lambda parts: sum(parts.values()))
    middle = ordered[len(ordered) // 4 : len(ordered) - len(ordered) // 4]
    names = dict.fromkeys(name for parts in middle for name in parts)
    return {name: mean(parts.get(name, 0.0) for parts in middle) for name in names}


@contextmanager
def timed_parts(trainer: Trainer, watch: Stopwatch) -> Iterator[None]:
    """Inside the block the steps of `trainer` tell the stopwatch which part they enter and leave."""
    graph = _Graph(watch)
    with ExitStack() as undo:
        for owner, name, part in _seams(trainer):
            undo.enter_context(replaced(owner, name, graph.timed(part, getattr(owner, name))))
        undo.enter_context(
            replaced(trainer.hooks, "losses", _losses_one_by_one(trainer.hooks, graph))
        )
        undo.enter_context(replaced(trainer, "step", graph.forgetting(trainer.step)))
        yield


@contextmanager
def replaced(owner: Any, name: str, value: object) -> Iterator[None]:
    """`owner.name` is `value` inside the block."""
    own, before = name in vars(owner), getattr(owner, name)
    setattr(owner, name, value)
    try:
        yield
    finally:
        if own:
            setattr(owner, name, before)
        else:
            delattr(owner, name)


def _seams(trainer: Trainer) -> Iterator[tuple[Any, str, str]]:
    """Owner and name of each function that is a part, and what the part is called."""
    field = trainer.field
    yield trainer.batches, "draw", RAYS
    for hook in ("needs", "ray_bounds", "encoder_input"):
        yield trainer.hooks, hook, HOOKS
    for name, function in vars(sampling).items():
        if isfunction(function) and getattr(renderer, name, None) is function:
            yield renderer, name, SAMPLING
    yield field.grid, "forward", GRID
    for name in ("raw_density", "density", "color"):
        yield field, name, NETWORKS
    # Whatever is left of rendering when sampling, grid and networks are taken away.
    yield trainer.renderer, "render", COMPOSITING
    yield loss, "color_error", COLOR_LOSS
    yield trainer.optimizer, "step", OPTIMIZER
    yield trainer.average, "update", AVERAGE


def _losses_one_by_one(hooks: Hooks, graph: _Graph) -> Callable[[Rendering, Step], list[Term]]:
    """What `hooks.losses` returns, each plugin a part of its own."""
    each = [
        graph.timed(f"{name} loss", Hooks({name: plugin}).losses)
        for name, plugin in hooks.plugins.items()
    ]

    def losses(rendering: Rendering, step: Step) -> list[Term]:
        return [term for of_plugin in each for term in of_plugin(rendering, step)]

    return losses


class _Graph:
    """Finds the nodes of the autograd graph that a part has made, and tells the stopwatch when they run backward."""

    def __init__(self, watch: Stopwatch) -> None:
        self._watch = watch
        # Kept for the whole step: a node is known by its Python object, which must not be made anew.
        self._claimed: set[Node] = set()

    def timed(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, its time and that of its backward pass counted as those of `part`."""

        def run(*args: Any, **kwargs: Any) -> Any:
            before = set(_nodes((args, *kwargs.values())))
            with self._watch.part(part):
                result = function(*args, **kwargs)
            self._claim(f"{part}{BACKWARD}", _nodes(result), before)
            return result

        return run

    def forgetting(self, step: Callable[[], Any]) -> Callable[[], Any]:
        """The step, after which its graph may go."""

        def run() -> Any:
            try:
                return step()
            finally:
                self._claimed.clear()

        return run

    def _claim(self, part: str, last: Iterable[Node], before: set[Node]) -> None:
        """All nodes from `last` back to those `before` them, but for what parts inside have claimed."""
        seen, stack = set(before), list(last)
        while stack:
            node = stack.pop()
            # A gradient that Python has seen is copied before it is kept, hence no hooks on those that keep it.
            if node in seen or hasattr(node, "variable"):
                continue
            seen.add(node)
            stack += [earlier for earlier, _ in node.next_functions if earlier is not None]
            if node not in self._claimed:
                self._claimed.add(node)
                node.register_prehook(lambda _: self._watch.enter(part))
                node.register_hook(lambda *_: self._watch.leave())


def _nodes(value: object) -> Iterator[Node]:
    """The nodes that made the tensors in a value, in sequences and dataclasses too."""
    if isinstance(value, Tensor):
        if value.grad_fn is not None:
            yield value.grad_fn
    elif isinstance(value, (list, tuple)):
        for item in value:
            yield from _nodes(item)
    elif is_dataclass(value):
        for field in fields(value):
            yield from _nodes(getattr(value, field.name))

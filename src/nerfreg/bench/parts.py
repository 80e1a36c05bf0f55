"""The parts of a training step, and how long each takes, forward and backward."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import fields, is_dataclass
from statistics import mean
from time import perf_counter
from typing import Any
from unittest.mock import patch

from torch import Tensor
from torch.autograd.graph import Node

from nerfreg.bench.configured import step_at
from nerfreg.hooks import Rendering, Step
from nerfreg.registry import Hooks, Term
from nerfreg.rendering import renderer, spans
from nerfreg.training import loss
from nerfreg.training.trainer import Trainer

BACKWARD = " backward"
"""Ends the name of a part's backward pass."""
REST = "rest"
"""What belongs to no part: zeroing, checks, and what autograd does between the parts, such as
adding up gradients."""


class Stopwatch:
    """Adds up seconds by part; those of all parts add up to those of the outermost.

    A part that is entered inside another stops the time of that one until it is left. The backward
    pass of a function is a part, too: its autograd nodes are found and tell when they run.
    """

    def __init__(self) -> None:
        self._seconds: defaultdict[str, float] = defaultdict(float)
        self._open: list[str] = []
        self._since = 0.0
        # Kept until the time is taken: a node is known by its Python object, which autograd would
        # make anew if it were gone.
        self._claimed: set[Node] = set()

    def enter(self, part: str) -> None:
        """Let the time run for another part."""
        self._credit()
        self._open.append(part)

    def leave(self) -> None:
        """Leave the part that was entered last; the time of the one around it goes on."""
        self._credit()
        self._open.pop()

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Enter a part for the block."""
        self.enter(name)
        try:
            yield
        finally:
            self.leave()

    def timed(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Count the time of a function and that of its backward pass as those of a part."""

        def run(*args: Any, **kwargs: Any) -> Any:
            before = set(_nodes((args, *kwargs.values())))
            with self.part(part):
                result = function(*args, **kwargs)
            self._claim(f"{part}{BACKWARD}", _nodes(result), before)
            return result

        return run

    def take(self) -> dict[str, float]:
        """Return seconds by part since the last call, and begin again from 0."""
        taken = dict(self._seconds)
        self._seconds.clear()
        self._claimed.clear()
        return taken

    def _credit(self) -> None:
        now = perf_counter()
        if self._open:
            self._seconds[self._open[-1]] += now - self._since
        self._since = now

    def _claim(self, part: str, last: Iterable[Node], before: set[Node]) -> None:
        # All nodes from `last` back to those `before` them, but for those of parts inside.
        seen, stack = set(before), list(last)
        while stack:
            node = stack.pop()
            # A gradient that Python has seen is copied before it is kept, hence no hooks on those
            # nodes that keep it.
            if node in seen or hasattr(node, "variable"):
                continue
            seen.add(node)
            stack += [earlier for earlier, _ in node.next_functions if earlier is not None]
            if node not in self._claimed:
                self._claimed.add(node)
                node.register_prehook(lambda _: self.enter(part))
                node.register_hook(lambda *_: self.leave())


def measure_parts(trainer: Trainer, at: float, steps: int) -> dict[str, float]:
    """Return milliseconds of each part of a step at share `at` of the budget.

    They add up to a whole step: the mean over the middle half of `steps` steps, so that a step
    which was disturbed does not count.
    """
    taken = []
    with timed_parts(trainer) as watch:
        for _ in range(steps):
            with watch.part(REST):
                step_at(trainer, at)
            taken.append(watch.take())
    return {part: 1e3 * seconds for part, seconds in middle_mean(taken).items()}


def middle_mean(taken: Sequence[dict[str, float]]) -> dict[str, float]:
    """Return the mean by part over those steps whose sum is in the middle half."""
    ordered = sorted(taken, key=lambda parts: sum(parts.values()))
    middle = ordered[len(ordered) // 4 : len(ordered) - len(ordered) // 4]
    names = dict.fromkeys(name for parts in middle for name in parts)
    return {name: mean(parts.get(name, 0.0) for parts in middle) for name in names}


@contextmanager
def timed_parts(trainer: Trainer) -> Iterator[Stopwatch]:
    """Make steps of a trainer tell a stopwatch, to be read after each, which part they are in."""
    watch = Stopwatch()
    plugins = trainer.hooks.plugins.items()
    each = [watch.timed(f"{name} loss", Hooks({name: plugin}).losses) for name, plugin in plugins]

    def losses(rendering: Rendering, step: Step) -> list[Term]:
        # The same as those of all plugins together, but each is a part.
        return [term for one in each for term in one(rendering, step)]

    with ExitStack() as undo:
        for owner, name, part in _seams(trainer):
            timed = watch.timed(part, getattr(owner, name))
            undo.enter_context(patch.object(owner, name, timed))
        undo.enter_context(patch.object(trainer.hooks, "losses", losses))
        yield watch


HOOKS = (
    "begin", "needs", "rays", "ray_bounds", "occupancy", "empty", "encoder_input", "density",
    "color_input", "rendering", "step_end",
)  # fmt: skip
"""The hooks of a step that are timed together; losses are timed by plugin."""


def _seams(trainer: Trainer) -> Iterator[tuple[Any, str, str]]:
    """Yield owner and name of each function that is a part, and what the part is called."""
    yield trainer.batches, "draw", "rays"
    for hook in HOOKS:
        yield trainer.hooks, hook, "hooks"
    for name in ("stratified", "arranged"):
        yield spans.Spans, name, "sampling"
    for name in ("importance", "sampled_runs"):
        yield renderer, name, "sampling"
    yield trainer.field.grid, "forward", "hash grid"
    for name in ("raw_density", "density", "color"):
        yield trainer.field, name, "networks"
    # Whatever is left of rendering when sampling, grid and networks are taken away.
    yield trainer.renderer, "render", "compositing"
    yield loss, "color_error", "color loss"
    yield trainer.optimizer, "step", "optimizer"
    yield trainer.average, "update", "moving average"


def _nodes(value: object) -> Iterator[Node]:
    """Yield the nodes that made the tensors in a value, in sequences and dataclasses too."""
    if isinstance(value, Tensor) and value.grad_fn is not None:
        yield value.grad_fn
    elif isinstance(value, (list, tuple)):
        for item in value:
            yield from _nodes(item)
    elif is_dataclass(value):
        for field in fields(value):
            yield from _nodes(getattr(value, field.name))

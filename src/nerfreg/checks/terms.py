"""Checks of the terms of a loss over several cases: whether they have gradients, and chunks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from nerfreg.checks.accuracy import relative_error
from nerfreg.checks.cases import CASES
from nerfreg.checks.driver import Driver
from nerfreg.checks.inputs import Inputs, cast
from nerfreg.checks.report import LIMITS, Report
from nerfreg.checks.steps import RunCase, small_inputs
from nerfreg.checks.subject import Subject
from nerfreg.checks.thread_count import threads_set
from nerfreg.field.workers import threads
from nerfreg.rays.batch import Batch

TERMS_CASE = RunCase("terms", "terms of several cases: gradients, chunks of rays, threads")
TRIED = ("fog", "thickness_1", "two_walls", "disagreement", "ramp")
"""Cases in one of which a term should have a gradient."""

MOVED, APART = 1e-2, 0.5
"""Relative changes of densities, and changes of colours: a little, and between two batches."""

MANY = 128
"""How many times the rays of a case are repeated, so that torch uses several threads."""


@dataclass
class Seen:
    """What is known of one term.

    Attributes:
        graded: Whether it has had a gradient that is not 0.
        attached: Whether it is part of a graph at all.
        changed: Whether its value has changed with densities and colours.
    """

    graded: bool = False
    attached: bool = False
    changed: bool = False


def check_terms(report: Report, case: RunCase, _: None) -> None:
    """Check that terms have gradients, and that chunks and threads make no difference."""
    report.judge("gradient", _without_gradient(report.subject))
    with report.at(report.spot, "invariance"):
        lines = _by_chunks(report.subject)
        if lines is None:
            report.skip("invariance", "the loss draws random numbers, others for another batch")
        else:
            report.judge("invariance", [*lines, *_by_threads(report.subject)])


def _without_gradient(subject: Subject) -> list[str]:
    """Terms that train nothing in any of the cases."""
    seen: dict[str, Seen] = {}
    for known in (known for known in CASES if known.name in TRIED):
        inputs = cast(known.build(48), torch.float32)
        moved = _values(subject, _moved(inputs, MOVED))[0]
        terms, driver = _values(subject, inputs)
        for name, value in terms.items():
            term = seen.setdefault(name, Seen())
            after = moved.get(name, value)
            term.changed |= not torch.allclose(after, value, rtol=1e-6, equal_nan=True)
            term.attached |= value.requires_grad
            term.graded |= value.requires_grad and _has_gradient(value, driver)
    return [f"term '{name}' {line}" for name, term in seen.items() for line in _in_words(term)]


def _in_words(term: Seen) -> Iterator[str]:
    if term.graded:
        return
    where = "although it changes with density and colour" if term.changed else "and never changes"
    if not term.attached:
        yield f"has no gradient by anything, {where}: is it detached, or made by numpy or .item()?"
    else:
        yield f"has a gradient of 0 everywhere, {where}: it trains nothing"


def _has_gradient(value: Tensor, driver: Driver) -> bool:
    tensors = [leaf for _, leaf in driver.leaves]
    grads = torch.autograd.grad(value, tensors, allow_unused=True, retain_graph=True)
    return any(grad is not None and bool(grad.any()) for grad in grads)


def _moved(inputs: Inputs, size: float) -> Inputs:
    generator = torch.Generator().manual_seed(3)
    by = torch.randn(inputs.density.shape, generator=generator)
    colors = inputs.colors + size * torch.randn(inputs.colors.shape, generator=generator)
    return replace(inputs, density=inputs.density * torch.exp(size * by), colors=colors)


def _values(subject: Subject, inputs: Inputs) -> tuple[dict[str, Tensor], Driver]:
    driver = Driver(subject, inputs)
    return driver.terms(driver.step()), driver


def _by_chunks(subject: Subject) -> list[str] | None:
    """Terms of two batches together that are not the mean of both; None for random terms."""
    first, second = small_inputs(48), _moved(small_inputs(48), APART)
    driver = Driver(subject, first)
    batch = Batch.of(first.rays, driver.step())
    terms = driver.terms(batch.step)
    if batch.drawn:
        return None
    other, both = (_values(subject, inputs)[0] for inputs in (second, first.joined(second)))
    halves = {name: (value + other[name]) / 2 for name, value in terms.items()}
    return _unlike(halves, both, "chunks of rays: the mean over two halves is {}, both at once {}")


def _by_threads(subject: Subject) -> list[str]:
    inputs = small_inputs(48).repeated(MANY)
    with threads_set(1):
        one = _values(subject, inputs)[0]
    with threads_set(max(threads(), 2)):
        several = _values(subject, inputs)[0]
    return _unlike(one, several, "the number of threads: {} with one, {} with several")


def _unlike(first: Mapping[str, Tensor], second: Mapping[str, Tensor], words: str) -> list[str]:
    limit = LIMITS["float32"]
    pairs = {name: (value.detach(), second[name].detach()) for name, value in first.items()}
    return [
        f"term '{name}' depends on {words.format(*(f'{x.item():.7g}' for x in pair))}"
        for name, pair in pairs.items()
        if not relative_error(*pair, "float32") <= limit
    ]

"""A batch is rendered again from the state that its generator had."""

from __future__ import annotations

from contextlib import nullcontext
from types import SimpleNamespace

import pytest
import torch

from nerfreg.errors import NoRendererError
from nerfreg.hooks import Rays, Step
from nerfreg.rays.batch import Batch


def echo() -> SimpleNamespace:
    """A renderer that gives back a random number of the step, in place of a rendering."""
    return SimpleNamespace(
        render=lambda rays, step, like=None: torch.rand(1, generator=step.generator).item(),
        frozen=nullcontext,
        cast=lambda rays, step: rays,
        view=lambda step: None,
    )


@pytest.fixture
def batch(rays: Rays) -> Batch:
    generator = torch.Generator().manual_seed(3)
    torch.rand(5, generator=generator)
    return Batch.of(rays, Step(2, 10, 0.2, generator, (1.0, 3.0), echo()))


def test_again_draws_what_was_drawn_and_leaves_the_first_generator_alone(batch: Batch) -> None:
    first = batch.step.renderer.render(batch.rays, batch.step)
    after = batch.step.generator.get_state()
    again = batch.again(echo())
    assert again.step.renderer.render(again.rays, again.step) == first
    assert torch.equal(batch.step.generator.get_state(), after)
    assert (again.step.index, again.step.total, again.step.bounds) == (2, 10, (1.0, 3.0))


def test_drawn(batch: Batch) -> None:
    assert not batch.drawn
    torch.rand(1, generator=batch.step.generator)
    assert batch.drawn and not batch.again(echo()).drawn


def test_without_a_renderer_nothing_is_rendered(rays: Rays, step, rendering) -> None:
    with pytest.raises(NoRendererError, match="no renderer"):
        Batch.of(rays, step(index=0)).render()
    with pytest.raises(NoRendererError, match="no renderer"):
        step(index=0).rerender(rendering(opacity=torch.ones(1)))

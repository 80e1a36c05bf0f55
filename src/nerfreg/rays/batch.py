"""The rays of one step, and what is needed to render them again exactly as they were rendered."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import UInt8
from torch import Tensor

from nerfreg.errors import NoRendererError
from nerfreg.hooks import RayRenderer, Rays, Rendering, Step


@dataclass(frozen=True)
class Batch:
    """Rays with the step that they belong to.

    Attributes:
        rays: The rays.
        step: Where the run stood; its renderer renders the rays.
        rng_state: State of the step's generator before the rays are rendered.
    """

    rays: Rays
    step: Step
    rng_state: UInt8[Tensor, " bytes"]

    @classmethod
    def of(cls, rays: Rays, step: Step) -> Batch:
        """Return a batch of these rays, with the state that the step's generator has now."""
        return cls(rays, step, step.generator.get_state())

    @property
    def drawn(self) -> bool:
        """Whether random numbers have been drawn from the step's generator since."""
        return not torch.equal(self.rng_state, self.step.generator.get_state())

    def render(self) -> Rendering:
        """Render the rays.

        Raises:
            NoRendererError: The step has no renderer.
        """
        if self.step.renderer is None:
            raise NoRendererError("this batch has no renderer: call `again` with one")
        renderer, step = self.step.renderer, self.step
        return renderer.render(renderer.cast(self.rays, step), step)

    def again(self, renderer: RayRenderer) -> Batch:
        """Return the same batch for another renderer.

        Rendering it draws the same samples as the first time, and leaves the generator of the run
        as it is.
        """
        # A new generator, because the run's has been advanced since, and must not be advanced by
        # looking at a step a second time.
        generator = torch.Generator()
        generator.set_state(self.rng_state)
        return replace(self, step=replace(self.step, generator=generator, renderer=renderer))

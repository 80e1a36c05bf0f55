"""Sample space annealing: rays grow from their middle. Source: RegNeRF (Niemeyer et al. 2022)."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from typing import Any, ClassVar, no_type_check

import mpmath
from jaxtyping import Float
from torch import Tensor

from nerfreg import NerfregError, Rays, Regularizer, Step, hookimpl
from nerfreg.numerics import exact, single
from nerfreg_plugins.references import annealing as reference


def annealed_bounds(
    near: Float[Tensor, " rays"],
    far: Float[Tensor, " rays"],
    step: int | float,
    steps: int | float,
    start: float,
    mid: float,
) -> tuple[Float[Tensor, " rays"], Float[Tensor, " rays"]]:
    """Return t_m + (t_n - t_m) eta(i) and t_m + (t_f - t_m) eta(i).

    eta(i) is min(max(i / N_t, p_s), 1). From i = N_t on, near and far come back exactly. The new
    bounds are always in order and inside the old ones.

    Args:
        near: t_n of each ray, `(R,)`, at least 0.
        far: t_f of each ray, `(R,)`, at least t_n.
        step: i.
        steps: N_t, in the unit of `step`.
        start: p_s in (0, 1].
        mid: Where t_m lies between near (0) and far (1).
    """
    missing = 1 - _eta(step, steps, start)
    if missing == 0:
        return near, far
    low, high = single(near), single(far)
    # Both are means of near and far whose factors add up to 1, so that nothing cancels. A mean may
    # be rounded to just outside of what it is a mean of, hence the clamps.
    a, b = missing * mid, missing * (1 - mid)
    new_near = (low * (1 - a) + high * a).clamp(low, high)
    new_far = (low * b + high * (1 - b)).clamp(new_near, high)
    return new_near.to(near.dtype), new_far.to(far.dtype)


def _eta(step: int | float, steps: int | float, start: float) -> float:
    return min(max(step / steps, start), 1.0) if steps > 0 else 1.0


@dataclass
class Annealing(Regularizer):
    """Rays are sampled around their middle first, and grow to their full length (RegNeRF).

    Attributes:
        weight: There is no loss; 0 switches annealing off, anything else has no effect.
        duration: How long rays grow, in steps (an integer) or as a fraction of the budget.
        initial: Share of the length that is sampled at first, in (0, 1].
        mid: The middle, from near (0) to far (1).
    """

    # The paper names no duration. Growth is over before the terms on depth and distribution set
    # in (0.1).
    duration: int | float = 0.05
    initial: float = 0.5
    mid: float = 0.5

    cite: ClassVar[str] = "niemeyer2022regnerf"

    def __post_init__(self) -> None:
        if not 0 < self.initial <= 1:
            raise NerfregError(
                f"reg.annealing.initial: {self.initial} is not in (0, 1]; 1 switches annealing off"
            )
        if not 0 <= self.mid <= 1:
            raise NerfregError(
                f"reg.annealing.mid: {self.mid} is not in [0, 1]; 0 is near, 1 is far"
            )

    @hookimpl(wrapper=True)
    @no_type_check  # a checker that wraps the generator would hide it from pluggy
    def nerfreg_ray_bounds(
        self, step: Step
    ) -> Generator[
        None,
        tuple[Float[Tensor, " rays"], Float[Tensor, " rays"]],
        tuple[Float[Tensor, " rays"], Float[Tensor, " rays"]],
    ]:
        near, far = yield
        return annealed_bounds(near, far, self._done(step), self.duration, self.initial, self.mid)

    def _done(self, step: Step) -> int | float:
        return step.index if isinstance(self.duration, int) else step.fraction

    @hookimpl
    def nerfreg_reference(self, given: Any, step: Step) -> dict[str, Any] | None:
        if not isinstance(given, Rays):
            return None
        eta = mpmath.mpf(_eta(self._done(step), self.duration, self.initial))
        bounds = exact(given.near), exact(given.far)
        near, far = reference.annealed_bounds(*bounds, eta, mpmath.mpf(self.mid))
        return {"near": near, "far": far}

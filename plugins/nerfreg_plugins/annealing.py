"""Sample space annealing: rays grow from their middle. Source: RegNeRF (Niemeyer et al. 2022)."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from typing import ClassVar, no_type_check

import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg import NerfregError, Regularizer, Step, hookimpl


def annealed_bounds(
    near: Float[Tensor, " rays"],
    far: Float[Tensor, " rays"],
    step: int | float,
    steps: int | float,
    start: float,
    mid: float,
) -> tuple[Float[Tensor, " rays"], Float[Tensor, " rays"]]:
    """t_n(i) = t_m + (t_n - t_m) eta(i), likewise t_f, with eta(i) = min(max(i / N_t, p_s), 1).

    near, far: (R,) t_n and t_f. step, steps: i and N_t in the same unit. start: p_s in (0, 1]. mid: where t_m lies
    between near (0) and far (1). From i = N_t on, near and far come back exactly.
    """
    eta = min(max(step / steps, start), 1.0) if steps > 0 else 1.0
    middle = torch.lerp(near, far, mid)
    return torch.lerp(middle, near, eta), torch.lerp(middle, far, eta)


@dataclass
class Annealing(Regularizer):
    """Rays are sampled around their middle first, and grow to their full length (RegNeRF).

    duration: how long they grow, in steps (integer) or as a fraction of the budget. initial: the share of the
    length that is sampled at first, in (0, 1]. mid: the middle, from near (0) to far (1). It returns no loss;
    `weight` only switches it off, by 0.
    """

    # The paper names no duration. Growth is over before the terms on depth and distribution set in (0.1).
    duration: int | float = 0.05
    initial: float = 0.5
    mid: float = 0.5

    cite: ClassVar[str] = """@inproceedings{niemeyer2022regnerf,
  title = {{RegNeRF}: Regularizing Neural Radiance Fields for View Synthesis from Sparse Inputs},
  author = {Niemeyer, Michael and Barron, Jonathan T. and Mildenhall, Ben and Sajjadi, Mehdi S. M.
            and Geiger, Andreas and Radwan, Noha},
  booktitle = {CVPR},
  year = {2022}
}"""

    def __post_init__(self) -> None:
        if not 0 < self.initial <= 1:
            raise NerfregError(f"reg.annealing.initial: {self.initial} is not in (0, 1]; 1 switches annealing off")
        if not 0 <= self.mid <= 1:
            raise NerfregError(f"reg.annealing.mid: {self.mid} is not in [0, 1]; 0 is near, 1 is far")

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
        done = step.index if isinstance(self.duration, int) else step.fraction
        return annealed_bounds(near, far, done, self.duration, self.initial, self.mid)

"""Adversarial perturbation of what the field sees, computes and renders.

Source: Aug-NeRF (Chen et al. 2022).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar, no_type_check

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from nerfreg import Regularizer, Rendering, Samples, Step, WrappedLayer, hookimpl
from nerfreg.errors import require_range
from nerfreg.numerics import exact
from nerfreg_plugins.references import adversarial as reference

Render = Callable[[Rendering], Rendering]
TARGETS = ("positions", "directions", "t", "features", "sigma", "rgb")
"""What can be perturbed, by the names of the radii."""


def pgd_step(delta: Tensor, grad: Tensor, step_size: float, radius: float) -> Tensor:
    """Return clip(delta + a sign(grad)): one step of projected gradient ascent in an l_inf ball.

    Where the gradient is 0 nothing moves.

    Args:
        delta: The perturbation, of any shape.
        grad: Gradient of the error with respect to it.
        step_size: a > 0.
        radius: Of the ball.
    """
    return (delta + step_size * grad.sign()).clamp(-radius, radius)


class Perturbed(WrappedLayer):
    """A layer whose input and output can be shifted.

    Attributes:
        in_features: Width of its input.
        out_features: Width of its output.
        features: What is added to the input, `(P, in)`; None for nothing.
        raw: What is added to the first columns of the output, `(P, columns)`; None for nothing.
    """

    def __init__(self, inner: nn.Module, in_features: int, out_features: int) -> None:
        super().__init__(inner)
        self.in_features = in_features
        self.out_features = out_features
        self.features: Float[Tensor, "points in"] | None = None
        self.raw: Float[Tensor, "points columns"] | None = None

    def added_input(self) -> Float[Tensor, "points in"] | None:
        """Return the shift of the input."""
        return self.features

    def added_output(self) -> Float[Tensor, "points out"] | None:
        """Return the shift of the output."""
        if self.raw is None:
            return None
        # Raw density is the first column of the density network's output; the geometry features
        # behind it stay as they are.
        return functional.pad(self.raw, (0, self.out_features - self.raw.shape[1]))


@dataclass
class Adversarial(Regularizer):
    """The rendered error under the worst small perturbation, found by PGD (Aug-NeRF).

    Costs `steps` + 1 more renderings a step. `positions` to `rgb` are radii of l_inf balls, 0 for
    off.

    Attributes:
        positions: Of sample positions, relative to the length of the scene, far - near.
        directions: Of the unit vectors of viewing directions, which are normalised again.
        t: Of samples along their ray, relative to the length of the scene.
        features: Of the encoded input of the density network.
        sigma: Of raw density, before its activation.
        rgb: Of raw colours, before their activation.
        steps: Number of PGD steps, which start from no perturbation.
        step_size: Length of a step, relative to the radius.
    """

    # Published values belong to other encodings. These move a point by less than a cell of the
    # finest grid level: all samples move against the image at once, and where they can change
    # cells, nothing but fog survives (chair, held-out views: 17.6 dB with ten times the radii, 25.0
    # with these).
    positions: float = 1e-4
    directions: float = 1e-3
    t: float = 1e-4
    features: float = 1e-3
    sigma: float = 5e-3
    rgb: float = 5e-3
    steps: int = 1
    step_size: float = 1.0

    cite: ClassVar[str] = "chen2022augnerf"

    def __post_init__(self) -> None:
        require_range("reg.adversarial", self, **dict.fromkeys(TARGETS, (0.0, math.inf)))
        self._layers: dict[str, Perturbed] = {}
        self._deltas: dict[str, Tensor] = {}

    @hookimpl(wrapper=True)
    @no_type_check  # a checker that wraps the generator would hide it from pluggy
    def nerfreg_layer(
        self, network: str, index: int, in_features: int, out_features: int, activation: str
    ) -> Generator[None, nn.Module, nn.Module]:
        layer = yield
        last = activation == "none"
        here = {
            "features": network == "density" and index == 0,
            "sigma": network == "density" and last,
            "rgb": network == "color" and last,
        }
        targets = [name for name, present in here.items() if present and getattr(self, name) > 0]
        if not targets:
            return layer
        perturbed = Perturbed(layer, in_features, out_features)
        self._layers.update(dict.fromkeys(targets, perturbed))
        return perturbed

    @hookimpl(wrapper=True)
    @no_type_check  # a checker that wraps the generator would hide it from pluggy
    def nerfreg_encoder_input(self) -> Generator[None, Samples, Samples]:
        samples = yield
        if not self._deltas:
            return samples
        positions, directions, t = samples.positions, samples.directions, samples.t
        # Another plugin may have made directions differ along a ray.
        per_sample = directions.ndim == 3
        if (shift := self._deltas.get("t")) is not None:
            along = directions if per_sample else directions[:, None]
            positions = positions + shift[..., None] * along
            t = t + shift
        if (shift := self._deltas.get("positions")) is not None:
            positions = positions + shift
        # After t, which moves samples along the rays as they were cast.
        if (shift := self._deltas.get("directions")) is not None:
            moved = directions + (shift[:, None] if per_sample else shift)
            directions = functional.normalize(moved, dim=-1)
        return replace(samples, positions=positions, directions=directions, t=t)

    @hookimpl
    def nerfreg_loss(self, rendering: Rendering, step: Step) -> dict[str, Float[Tensor, ""]]:
        # Whatever happens in between, the next rendering must not be perturbed.
        try:
            worst = self._worst(rendering, step)
            return {"adversarial": self._error(step.rerender, rendering, worst)}
        finally:
            self._set({})

    def _worst(self, rendering: Rendering, step: Step) -> dict[str, Tensor]:
        """Return the perturbations that PGD ends with.

        They are constants to the loss: the field is trained against them, not through the search.
        """
        radii = self._radii(step)
        deltas = {
            name: rendering.t.new_zeros(shape) for name, shape in self._shapes(rendering).items()
        }
        for _ in range(self.steps):
            deltas = {name: delta.requires_grad_() for name, delta in deltas.items()}
            # The search needs no gradient of the weights.
            error = self._error(partial(step.rerender, frozen=True), rendering, deltas)
            # Some perturbations may have no influence, as that of colours where all is empty.
            grads = torch.autograd.grad(
                error, list(deltas.values()), allow_unused=True, materialize_grads=True
            )
            deltas = {
                name: pgd_step(delta.detach(), grad, self.step_size * radii[name], radii[name])
                for (name, delta), grad in zip(deltas.items(), grads, strict=True)
            }
        return deltas

    def _radii(self, step: Step) -> dict[str, float]:
        length = step.bounds[1] - step.bounds[0]
        return {
            name: getattr(self, name) * (length if name in ("positions", "t") else 1.0)
            for name in TARGETS
        }

    def _shapes(self, rendering: Rendering) -> dict[str, tuple[int, ...]]:
        rays, samples = rendering.t.shape
        shapes: dict[str, tuple[int, ...]] = {
            "positions": (rays, samples, 3),
            "directions": (rays, 3),
            "t": (rays, samples),
        }
        if "features" in self._layers:
            shapes["features"] = (rays * samples, self._layers["features"].in_features)
        shapes["sigma"] = (rays * samples, 1)
        # The colour network is evaluated for these samples alone, and again when rendered again.
        shapes["rgb"] = (int(rendering.colored.sum()), 3)
        return {name: shape for name, shape in shapes.items() if getattr(self, name) > 0}

    def _error(
        self, render: Render, rendering: Rendering, deltas: dict[str, Tensor]
    ) -> Float[Tensor, ""]:
        colors, targets = self._perturbed(render, rendering, deltas)
        return (colors - targets).square().mean()

    def _perturbed(
        self, render: Render, rendering: Rendering, deltas: dict[str, Tensor]
    ) -> tuple[Tensor, Tensor]:
        """Return the colours under the perturbations, and those they should have, (S, 3) each."""
        self._set(deltas)
        targets = rendering.rays.targets
        return render(rendering).rgb[: len(targets)], targets

    def _set(self, deltas: dict[str, Tensor]) -> None:
        self._deltas = deltas
        for name, layer in self._layers.items():
            setattr(layer, "features" if name == "features" else "raw", deltas.get(name))

    @hookimpl
    def nerfreg_reference(self, given: Any, step: Step) -> dict[str, Any] | None:
        if not isinstance(given, Rendering):
            return None
        try:
            perturbed = self._perturbed(step.rerender, given, self._worst(given, step))
        finally:
            self._set({})
        return {"adversarial": reference.mean_squared_error(*map(exact, perturbed))}

    @hookimpl
    def nerfreg_contract(self, step: Step) -> dict[str, float]:
        """Promise that every perturbation lies in its ball.

        The excess is relative to the radius, and absolute where that is 0.
        """
        radii = self._radii(step)
        moved = {
            name: delta.detach().double().abs()
            for name, delta in self._deltas.items()
            if delta.numel()
        }
        excess = {name: float(size.max()) - radii[name] for name, size in moved.items()}
        return {
            f"ball of {name}": max(over, 0.0) / (radii[name] or 1.0)
            for name, over in excess.items()
        }

"""What is wrong with what plugins make before the first step, and with the state that they keep.

One line for each mistake, none if nothing is wrong.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Tensor, nn

from nerfreg.hooks import TrainedModule
from nerfreg.numerics import not_finite
from nerfreg.scenes.scene import Photographs
from nerfreg.training.contracts import kind, unlike

PLAIN = (Tensor, bool, int, float, str, type(None))
"""What a checkpoint can hold besides lists and dictionaries."""


def wrong_encoder(encoder: object) -> list[str]:
    """Check that an encoder of `nerfreg_encoder` maps (P, 3) to (P, width), all finite.

    It is tried on two points; None stands for the core's encoder.
    """
    if encoder is None:
        return []
    if not isinstance(encoder, nn.Module):
        return [f"returned {kind(encoder)}, not a torch module"]
    width = getattr(encoder, "width", None)
    if not isinstance(width, int) or width < 1:
        found = "has no attribute `width`" if width is None else f"width={width!r}"
        return [f"{found}: must be an integer, the number of its features"]
    wrong = _not_finite_parameters(encoder)
    probe = torch.tensor([[0.0, 0.0, 1.0], [0.6, 0.8, 0.0]])
    try:
        with torch.no_grad(), torch.random.fork_rng(devices=[]):
            output = encoder(probe)
    except Exception as error:  # a foreign module may raise anything
        return [*wrong, f"fails on (P, 3): {type(error).__name__}: {error}".partition("\n")[0]]
    return wrong + unlike("output", output, probe.new_empty(2, width))


def wrong_module(given: object) -> list[str]:
    """Check that `nerfreg_module` returned None, a module, or a module with sound settings."""
    if given is None:
        return []
    settings = given if isinstance(given, TrainedModule) else None
    module = settings.module if settings else given
    if not isinstance(module, nn.Module):
        return [f"returned {kind(module)}, not a torch module; wrap parameters in an nn.Module"]
    wrong = _not_finite_parameters(module)
    if settings:
        numbers = {"lr_scale": settings.lr_scale, "weight_decay": settings.weight_decay}
        wrong += [
            f"{name}={value!r}: must be finite and not negative"
            for name, value in numbers.items()
            if not (math.isfinite(value) and value >= 0)
        ]
    return wrong


def wrong_prepared(photographs: Photographs, prepared: object) -> list[str]:
    """Check that `nerfreg_prepare` returned, by name, values of each pixel, (V, H, W, ...)."""
    if prepared is None:
        return []
    if not isinstance(prepared, Mapping):
        return [f"returned {kind(prepared)}; return a dict of tensors (V, H, W, ...) by name"]
    pixels, wrong = tuple(photographs.images.shape[:3]), []
    for name, values in prepared.items():
        if not isinstance(values, Tensor):
            wrong.append(f"'{name}' is {kind(values)}, not a tensor")
        elif tuple(values.shape[:3]) != pixels:
            shape, due = tuple(values.shape), f"({', '.join(map(str, pixels))}, ...)"
            wrong.append(f"'{name}' has shape {shape}, not {due}: a value for each pixel")
        elif values.dtype == torch.float64:
            wrong.append(f"'{name}' is in float64; return float32")
    return wrong


def wrong_state(state: object, name: str = "state_dict()") -> list[str]:
    """Check that a checkpoint can hold what `Regularizer.state_dict` returned.

    Args:
        state: What it returned, or a part of it.
        name: How the part is called in messages.
    """
    if isinstance(state, Mapping):
        unnamed = [key for key in state if not isinstance(key, str)]
        return [f"{name}: key {key!r} is {kind(key)}, not text" for key in unnamed] + [
            line for key, value in state.items() for line in wrong_state(value, f"{name}[{key!r}]")
        ]
    if name == "state_dict()":
        return [f"{name}: is {kind(state)}, not a dict"]
    if isinstance(state, list):
        parts = (wrong_state(value, f"{name}[{i}]") for i, value in enumerate(state))
        return [line for part in parts for line in part]
    held = "a checkpoint holds tensors, numbers, text, lists and dicts of these"
    return [] if isinstance(state, PLAIN) else [f"{name}: is {kind(state)}; {held}"]


def _not_finite_parameters(module: nn.Module) -> list[str]:
    return [line for name, values in module.named_parameters() for line in not_finite(name, values)]

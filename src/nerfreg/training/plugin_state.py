"""The state of plugins in two parts: plain values for JSON, and tensors."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from nerfreg.errors import PluginError

MARK = "$tensor"
"""Key of what stands in place of a tensor: a dictionary with the tensor's name."""

NUMBER = "$number"
"""Key of what stands in place of a number that is not finite: a dictionary with its name."""


def packed(states: dict[str, dict[str, Any]]) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """Split the states of plugins.

    Args:
        states: What each plugin's `state_dict` returned, by the plugin's name.

    Returns:
        The same with a mark in place of each tensor, and the tensors by name.

    Raises:
        PluginError: A state holds something that cannot be saved.
    """
    tensors: dict[str, Tensor] = {}

    def plain(value: Any, path: tuple[str, ...]) -> Any:
        if isinstance(value, Tensor):
            name = "/".join(path)
            # Cloned, because tensors that share memory are refused.
            tensors[name] = value.detach().cpu().clone(memory_format=torch.contiguous_format)
            return {MARK: name}
        if isinstance(value, dict):
            return {str(key): plain(part, (*path, str(key))) for key, part in value.items()}
        if isinstance(value, list | tuple):
            return [plain(part, (*path, str(place))) for place, part in enumerate(value)]
        if isinstance(value, float) and not math.isfinite(value):
            # JSON has no such numbers.
            return {NUMBER: str(value)}
        if value is None or isinstance(value, bool | int | float | str):
            return value
        raise PluginError(
            f"plugin {path[0]}, state_dict: '{'.'.join(path[1:])}' is of type "
            f"{type(value).__name__}; return tensors, numbers, strings, booleans, None, and lists "
            "and dictionaries of these"
        )

    return {name: plain(state, (name,)) for name, state in states.items()}, tensors


def unpacked(plain: Any, tensors: dict[str, Tensor]) -> Any:
    """Put what `packed` returned together again; tuples have become lists."""
    if isinstance(plain, dict):
        if plain.keys() == {MARK}:
            return tensors[plain[MARK]]
        if plain.keys() == {NUMBER}:
            return float(plain[NUMBER])
        return {key: unpacked(part, tensors) for key, part in plain.items()}
    if isinstance(plain, list):
        return [unpacked(part, tensors) for part in plain]
    return plain

"""Names of run folders."""

from __future__ import annotations

import re
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path

from omegaconf import DictConfig, OmegaConf

MAX_LENGTH = 100
IDENTITY = 8
"""Hexadecimal digits that distinguish two names which are equal otherwise."""

UNNAMED = ("name", "train.quiet")
"""Keys that do not change what a run computes."""


def slug(text: str) -> str:
    """Return overrides as part of a folder name.

    `+reg=[lipschitz,kl],seed=0` becomes `reg=lipschitz+kl,seed=0`, and a mapping `{a:1,b:2}`
    becomes `a-1+b-2`.
    """
    return re.sub(r"[^\w=.,+@-]+", "-", _without_syntax(text))[:MAX_LENGTH].strip("-,.")


def overrides_name(overrides: Sequence[str]) -> str:
    """Return a slug that no other overrides have; where it does not say all, it ends in a hash.

    The order of the overrides makes no difference. Regularizers and seed come first, and of a path
    only the last part is kept.
    """
    text = ",".join(
        sorted((override for override in overrides if _key(override) not in UNNAMED), key=_rank)
    )
    short = slug(re.sub(r"=[^,\[\]]*/", "=", text))
    return short if short == _without_syntax(text) else f"{short}_{digest(text)}"


def digest(text: str) -> str:
    """Return a few hexadecimal digits that stand for a text."""
    return sha256(text.encode()).hexdigest()[:IDENTITY]


def run_name(*, _root_: DictConfig) -> str:
    """Return `name` if the user gave one, else what was chosen, such as `llff_kl+lipschitz`."""
    name = OmegaConf.select(_root_, "name")
    if name:
        return slug(name)
    overrides = OmegaConf.select(_root_, "hydra.overrides.task", default=[])
    selection = next(
        (override for override in overrides if override.startswith("+reg=")), ""
    ).partition("=")[2]
    selection = selection or "+".join(OmegaConf.select(_root_, "reg", default={})) or "vanilla"
    return slug(f"{OmegaConf.select(_root_, 'hydra.runtime.choices.scene')}_{selection}")


def study_name(root: DictConfig) -> str:
    """Return `name` if the user gave one, else the last part of the scene's path, or its format."""
    path = OmegaConf.select(root, "scene.path")
    scene = Path(str(path)).name if path else OmegaConf.select(root, "hydra.runtime.choices.scene")
    return slug(OmegaConf.select(root, "name") or scene) or "sweep"


def _key(override: str) -> str:
    return override.partition("=")[0].lstrip("+~")


def _rank(override: str) -> tuple[int, str]:
    key = _key(override)
    first = [key == "reg", key.startswith("reg."), key == "seed", True]
    return first.index(True), override


def _without_syntax(text: str) -> str:
    lists_joined = re.sub(r"\[([^\]]*)\]", lambda match: match[1].replace(",", "+"), str(text))
    mappings_joined = re.sub(
        r"\{([^{}]*)\}",
        lambda match: re.sub(r" *, *", "+", match[1]).replace(": ", "-").replace(":", "-"),
        lists_joined,
    )
    return re.sub(r"(^|,)\++", r"\1", mappings_joined)

"""Names of run folders."""

from __future__ import annotations

import re

from omegaconf import DictConfig, OmegaConf

MAX_LENGTH = 100


def slug(text: str) -> str:
    """Overrides as part of a folder name: `+reg=[lipschitz,kl],seed=0` becomes `reg=lipschitz+kl,seed=0`."""
    lists_joined = re.sub(r"\[([^\]]*)\]", lambda match: match[1].replace(",", "+"), str(text))
    no_signs = re.sub(r"(^|,)\++", r"\1", lists_joined)
    return re.sub(r"[^\w=.,+-]+", "-", no_signs)[:MAX_LENGTH].strip("-,.")


def run_name(*, _root_: DictConfig) -> str:
    """`name` if the user gave one, else what was chosen: `llff_kl+lipschitz`, `procedural_vanilla`."""
    name = OmegaConf.select(_root_, "name")
    if name:
        return slug(name)
    overrides = OmegaConf.select(_root_, "hydra.overrides.task", default=[])
    selection = next((override for override in overrides if override.startswith("+reg=")), "").partition("=")[2]
    selection = selection or "+".join(OmegaConf.select(_root_, "reg", default={})) or "vanilla"
    return slug(f"{OmegaConf.select(_root_, 'hydra.runtime.choices.scene')}_{selection}")

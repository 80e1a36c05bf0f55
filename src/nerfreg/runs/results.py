"""What is recorded of a run: scores, costs, its configuration, and versions of what it ran with."""

from __future__ import annotations

import platform
from collections.abc import Iterator, Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from torch import Tensor

from nerfreg.config.plugin import settings_of
from nerfreg.config.schema import Config
from nerfreg.evaluation.scores import Scores
from nerfreg.field.workers import threads
from nerfreg.registry import Term, installed
from nerfreg.registry.plugins import find_plugin, is_used, plugin_name
from nerfreg.scenes import Scene
from nerfreg.training.checkpoint import State
from nerfreg.training.loss import label
from nerfreg.training.memory import peak_memory_mb

PACKAGES = ("nerfreg", "torch", "numpy", "numba", "hydra-core", "pluggy")
"""Distributions whose versions are recorded."""


def evaluation_record(
    state: State, scene: Scene, scores: Scores, terms: Sequence[Term]
) -> dict[str, Any]:
    """Return one line of `metrics.jsonl`.

    Args:
        state: Where the run stands.
        scene: Its scene.
        scores: Scores of the views that were evaluated.
        terms: Terms of the loss of the last step.
    """
    return {
        "step": state.step,
        "train_seconds": round(state.train_seconds, 3),
        "points": state.points,
        # The time is measured without compilation and might be 0 in a very short run.
        "points_per_second": state.points / max(state.train_seconds, 1e-9),
        "skipped_steps": state.skipped_steps,
        **scores.record(),
        "losses": {name: float(value) for name, value in losses(terms).items()},
        "test_views": per_view(scene, scores),
    }


def description(config: Config, scene: Scene) -> dict[str, Any]:
    """Return what tables need to know of a run besides its scores."""
    grid = ("levels", "base", "finest", "log2_entries")
    return {
        "scene": scene.name,
        "views": len(scene.train),
        "held_out": config.scene.held_out is not None,
        "train_views": [view_label(scene, view) for view in scene.train],
        "regularizers": {name: settings_of(plugin) for name, plugin in config.reg.items()},
        "plugins": _plugins(config),
        "notes": _notes(config),
        "grid": {key: getattr(config.field, key) for key in grid},
        "seed": config.seed,
        "threads": threads(),
        "versions": {
            "python": platform.python_version(),
            **{name: _version(name) for name in PACKAGES},
        },
        "peak_memory_mb": round(peak_memory_mb()),
    }


def losses(terms: Sequence[Term]) -> dict[str, Tensor]:
    """Return the unweighted terms of a loss, by their labels."""
    return {label(term): term.value for term in terms}


def per_view(scene: Scene, scores: Scores) -> dict[str, dict[str, float | None]]:
    """Return the scores of every view by its label."""
    return {
        view_label(scene, v.view): {
            "psnr": v.psnr,
            "ssim": v.ssim,
            "lpips": v.lpips,
            "depth_rmse": v.depth_rmse,
        }
        for v in scores.views
    }


def summary(results: dict[str, Any]) -> Iterator[str]:
    """Yield the scores of a run in one line, what it cost in another, and what must be noted."""
    names = ("psnr", "ssim", "lpips", "average", "depth_rmse")
    yield "  ".join(
        f"{name} {'n/a' if results[name] is None else format(results[name], '.4g')}"
        for name in names
    )
    yield (
        f"{results['step']} steps in {results['train_seconds']:.1f} s of training, "
        f"{results['points_per_second'] / 1e6:.2f} million points a second"
    )
    for name, note in results.get("notes", {}).items():
        yield f"note of {name}: {note}"


def view_label(scene: Scene, view: int) -> str:
    """Return the name of a view in a form that can be part of a file name."""
    return scene.labels[view].replace("/", "_") if scene.labels else f"view_{view}"


def _plugins(config: Config) -> dict[str, dict[str, str | None]]:
    """Return which plugins take part, by the names of their instances, and their packages."""
    known = installed()
    found = {}
    for name, plugin in config.reg.items():
        if is_used(plugin):
            address = plugin_name(name, plugin)
            info = find_plugin(address, known)
            package, version = (info.package, info.version) if info else (None, None)
            found[name] = {"plugin": address, "package": package, "version": version}
    return found


def _notes(config: Config) -> dict[str, str]:
    """Return what plugins say of the scores of a run in which they take part."""
    used = {name: plugin for name, plugin in config.reg.items() if is_used(plugin)}
    return {name: plugin.evaluation_note for name, plugin in used.items() if plugin.evaluation_note}


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None

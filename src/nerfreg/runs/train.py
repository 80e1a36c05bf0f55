"""One run from beginning to end, and what can be done with its folder afterwards."""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numba
import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg.config.saved import read_run
from nerfreg.config.schema import Config
from nerfreg.errors import NerfregError, NonFiniteError
from nerfreg.evaluation.config import EvalConfig, subset_of
from nerfreg.evaluation.images import depth_image, save_png, side_by_side
from nerfreg.evaluation.lpips import load_lpips
from nerfreg.evaluation.paths import orbit_path, spiral_path
from nerfreg.evaluation.scores import Scores, photograph, score_views
from nerfreg.evaluation.video import write_video
from nerfreg.field import RadianceField
from nerfreg.field.fit import fitted
from nerfreg.field.workers import set_threads, threads
from nerfreg.registry import Hooks, Term
from nerfreg.rendering.views import View, ViewRenderer
from nerfreg.runs.files import METRICS, RENDERS, RESULTS, append_metrics, write_results
from nerfreg.runs.recording import Recorder
from nerfreg.scenes import Scene, load_scene
from nerfreg.training.checked_hooks import CheckedHooks
from nerfreg.training.checkpoint import State, load_checkpoint, save_checkpoint
from nerfreg.training.guard import Guard
from nerfreg.training.loss import label
from nerfreg.training.memory import keep_large_blocks, peak_memory_mb
from nerfreg.training.progress import Progress
from nerfreg.training.trainer import Trainer

PACKAGES = ("nerfreg", "torch", "numpy", "numba", "hydra-core", "pluggy")


def train(config: Config, folder: Path) -> dict[str, Any]:
    """Train, score at log-spaced times, and leave a whole run in `folder`; returns what `results.json` holds.

    While the run lasts a fixed subset of the test views is scored, on some of their pixels; at the end all of them,
    at full size. Neither changes how the run goes on.
    """
    keep_large_blocks()
    scene = load_scene(config.scene)
    config = replace(config, field=fitted(config.field, scene))
    lpips = load_lpips(config.eval.lpips_weights) if config.eval.lpips else None
    device = prepare(config)
    progress = Progress(config.train.quiet)
    hooks = (
        CheckedHooks(config.reg, config.train.check_every)
        if config.train.check
        else Hooks(config.reg)
    )
    if hooks.depth_tellers:
        progress.message(
            f"{', '.join(hooks.depth_tellers)}: looking at {len(scene.train)} photographs"
        )
    trainer = Trainer(
        scene,
        hooks,
        config.field,
        config.sampler,
        config.optim,
        config.train,
        config.seed,
        device,
        Guard(Recorder(folder, config), progress.warning),
    )
    budget = trainer.budget
    (folder / METRICS).unlink(missing_ok=True)
    due = list(config.eval.times(config.train.seconds, config.train.steps))
    subset = subset_of(scene.test, config.eval.subset_size)
    psnr: float | None = None
    with progress:
        while budget.fraction < 1:
            try:
                terms = trainer.step()
            except NonFiniteError:
                _save(folder, trainer)
                raise
            progress.update(budget.step, budget.fraction, losses(terms), psnr)
            if due[0] <= budget.fraction < 1:
                due = [share for share in due if share > budget.fraction]
                with trainer.average.applied():
                    renderer = ViewRenderer(trainer.field, config.sampler, scene)
                    scores = score_views(
                        scene,
                        subset,
                        _strided(renderer, scene, config.eval),
                        lpips,
                        config.eval.pixels_stride,
                    )
                psnr = scores.psnr
                append_metrics(folder, _record(trainer, scores, terms))
        _save(folder, trainer)
        progress.message(f"scoring {len(scene.test)} test views")
        with trainer.average.applied():
            scores = score_views(
                scene, scene.test, _saving(trainer.field, config, scene, folder), lpips
            )
    record = _record(trainer, scores, terms)
    append_metrics(folder, record)
    results = {**record, **_about(config, scene), "peak_memory_mb": round(peak_memory_mb())}
    write_results(folder, results)
    for line in summary(results):
        print(line)
    print(folder)
    return results


def evaluate_run(run: Path, overrides: Sequence[str] = ()) -> dict[str, Any]:
    """Score the checkpoint of a run on all its test views again, and write its pictures and `results.json` anew."""
    config, scene, field, state = load_run(run, overrides)
    lpips = load_lpips(config.eval.lpips_weights) if config.eval.lpips else None
    scores = score_views(scene, scene.test, _saving(field, config, scene, run), lpips)
    results = {
        **asdict(state),
        **scores.record(),
        "points_per_second": state.points / max(state.train_seconds, 1e-9),
        "test_views": _per_view(scene, scores),
        **_about(config, scene),
        "peak_memory_mb": round(peak_memory_mb()),
    }
    write_results(run, results)
    for line in summary(results):
        print(line)
    print(run / RESULTS)
    return results


def render_run(
    run: Path, path: str, out: Path, frames: int = 60, fps: float = 30.0, format: str = "gif"
) -> None:
    """Render the test views of a run to PNG, or a camera path ("spiral", "orbit") to films of colour and depth."""
    config, scene, field, _ = load_run(run)
    renderer = ViewRenderer(field, config.sampler, scene)
    if path == "test":
        for view in scene.test:
            save_png(
                out / f"{_label(scene, view)}.png",
                _picture(scene, view, renderer.view(scene.cameras, view)),
            )
        print(out)
        return
    cameras = (spiral_path if path == "spiral" else orbit_path)(scene, frames)
    views = [renderer.view(cameras, frame) for frame in range(frames)]
    write_video(out / f"{path}_color.{format}", (view.rgb for view in views), fps)
    write_video(
        out / f"{path}_depth.{format}",
        (depth_image(view.depth, scene.near, scene.far, view.opacity) for view in views),
        fps,
    )
    print(out)


def load_run(
    run: Path, overrides: Sequence[str] = ()
) -> tuple[Config, Scene, RadianceField, State]:
    """The configuration, scene and trained field of a run's folder."""
    keep_large_blocks()
    config = read_run(run, overrides)
    scene = load_scene(config.scene)
    config = replace(config, field=fitted(config.field, scene))
    field = RadianceField(config.field, scene.box, Hooks(config.reg).layer)
    state = load_checkpoint(run, field)
    return config, scene, field.to(prepare(config)).eval(), state


def prepare(config: Config) -> torch.device:
    """Set the number of threads, and say which device is meant. Raises NerfregError for one that is not there."""
    count = threads() if config.train.threads is None else config.train.threads
    if not 1 <= count <= numba.config.NUMBA_NUM_THREADS:
        raise NerfregError(
            f"train.threads={count}: this machine has 1 to {numba.config.NUMBA_NUM_THREADS}"
        )
    set_threads(count)
    name = config.device
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    try:
        device = torch.device(name)
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:
        raise NerfregError(
            f"device={name}: not available here ({str(error).splitlines()[0]})"
        ) from error
    return device


def losses(terms: Sequence[Term]) -> dict[str, Tensor]:
    """Unweighted terms by name; a plugin with several names them `plugin.term`."""
    return {label(term): term.value for term in terms}


def summary(results: dict[str, Any]) -> Iterator[str]:
    """The scores of a run in one line, and what it took in another."""
    names = ("psnr", "ssim", "lpips", "average", "depth_rmse")
    yield "  ".join(
        f"{name} {'n/a' if results[name] is None else format(results[name], '.4g')}"
        for name in names
    )
    yield (
        f"{results['step']} steps in {results['train_seconds']:.1f} s of training, "
        f"{results['points_per_second'] / 1e6:.2f} million points a second"
    )


def _save(folder: Path, trainer: Trainer) -> None:
    """The averaged weights, as they are evaluated."""
    budget = trainer.budget
    with trainer.average.applied():
        state = State(budget.step, budget.seconds, trainer.renderer.points, trainer.guard.skipped)
        save_checkpoint(folder, trainer.field, state)


def _record(trainer: Trainer, scores: Scores, terms: Sequence[Term]) -> dict[str, Any]:
    """One line of `metrics.jsonl`."""
    budget, points = trainer.budget, trainer.renderer.points
    record: dict[str, Any] = {
        "step": budget.step,
        "train_seconds": round(budget.seconds, 3),
        "points": points,
        "points_per_second": points / max(budget.seconds, 1e-9),
        "skipped_steps": trainer.guard.skipped,
        **scores.record(),
        "losses": {name: float(value) for name, value in losses(terms).items()},
    }
    record["test_views"] = _per_view(trainer.scene, scores)
    return record


def _per_view(scene: Scene, scores: Scores) -> dict[str, dict[str, float | None]]:
    return {
        _label(scene, v.view): {
            "psnr": v.psnr,
            "ssim": v.ssim,
            "lpips": v.lpips,
            "depth_rmse": v.depth_rmse,
        }
        for v in scores.views
    }


def _about(config: Config, scene: Scene) -> dict[str, Any]:
    """What a table needs to know of a run beside its scores."""
    return {
        "scene": scene.name,
        "views": len(scene.train),
        "held_out": config.scene.held_out is not None,
        "train_views": [_label(scene, view) for view in scene.train],
        "regularizers": {name: asdict(plugin) for name, plugin in config.reg.items()},
        "grid": {
            key: getattr(config.field, key) for key in ("levels", "base", "finest", "log2_entries")
        },
        "seed": config.seed,
        "threads": threads(),
        "versions": {
            "python": platform.python_version(),
            **{name: _version(name) for name in PACKAGES},
        },
    }


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _strided(renderer: ViewRenderer, scene: Scene, config: EvalConfig) -> Callable[[int], View]:
    return lambda view: renderer.view(scene.cameras, view, config.pixels_stride)


def _saving(
    field: RadianceField, config: Config, scene: Scene, folder: Path
) -> Callable[[int], View]:
    """Render views at full size, and save pictures of as many as `eval.save_renders` says."""
    renderer = ViewRenderer(field, config.sampler, scene)
    saved = set(
        scene.test
        if config.eval.save_renders is None
        else subset_of(scene.test, config.eval.save_renders)
    )

    def render(view: int) -> View:
        rendered = renderer.view(scene.cameras, view)
        if view in saved:
            save_png(
                folder / RENDERS / f"{_label(scene, view)}.png", _picture(scene, view, rendered)
            )
        return rendered

    return render


def _picture(scene: Scene, view: int, rendered: View) -> Float[Tensor, "height panels 3"]:
    """Colour, depth, photograph and error beside each other."""
    return side_by_side(
        rendered.rgb,
        rendered.depth,
        scene.near,
        scene.far,
        rendered.opacity,
        photograph(scene, view),
    )


def _label(scene: Scene, view: int) -> str:
    return scene.labels[view].replace("/", "_") if scene.labels else f"view_{view}"

"""Run folders -> records. Folders may still be written while they are read."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from textwrap import shorten
from typing import Any

import yaml

from nerfreg.errors import NerfregError
from nerfreg.reports.methods import distinguished, method_of, scenes_distinguished
from nerfreg.reports.records import Evaluation, RunRecord
from nerfreg.runs.files import FAILED, METRICS, RENDERS, RESULTS

CONFIG, OVERRIDES = Path(".hydra", "config.yaml"), Path(".hydra", "overrides.yaml")
OTHER_VERBS = ("cameras.png",)
"""What is found in a folder with a configuration that `nerfreg train` did not make."""
LONGEST_REASON = 300
CONTENTS = (RENDERS, "checkpoint", "nonfinite")


def collect(places: Sequence[Path]) -> list[RunRecord]:
    """All runs in folders and in the folders below them, each once, named so that different methods differ.

    Raises NerfregError for a path that does not exist, and where no run is found at all.
    """
    folders: dict[Path, Path] = {}
    for place in places:
        if not place.is_dir():
            raise NerfregError(
                f"{place}: {'is a file; name a folder of runs' if place.exists() else 'does not exist'}"
            )
        for folder in find_runs(place):
            folders.setdefault(folder.resolve(), folder)
    if not folders:
        searched = ", ".join(map(str, places))
        raise NerfregError(
            f"{searched}: no run found (a run has {CONFIG} and {METRICS} or {RESULTS})"
        )
    records = _views_counted([read_run_folder(folder) for folder in folders.values()])
    return distinguished(scenes_distinguished(records))


def find_runs(place: Path) -> Iterator[Path]:
    """Folders of training runs in `place`, jobs of a sweep in the order of their numbers.

    A run that has not been scored yet is one too; what `nerfreg scene` left is none.
    """
    for root, names, files in os.walk(place):
        names[:] = sorted(
            (n for n in names if n not in CONTENTS and not n.startswith(".")), key=_natural
        )
        if (Path(root) / CONFIG).is_file() and (
            {METRICS, RESULTS, FAILED} & {*files} or not {*OTHER_VERBS} & {*files}
        ):
            yield Path(root)


def read_run_folder(folder: Path) -> RunRecord:
    """What a folder says. Whatever is missing, half-written or null in it is None, or is left out."""
    results = _read_json(folder / RESULTS)
    settings = {**_flat(_read_yaml(folder / CONFIG)), **_flat(results.get("regularizers"), "reg.")}
    command = tuple(map(str, _read_yaml(folder / OVERRIDES) or ()))
    lines, torn = _read_lines(folder / METRICS)
    final = _evaluation(results, whole=True)
    if final and lines and not torn and lines[-1].get("step") != final.step:
        final, results = None, {}  # of an earlier run in the same folder, that is being repeated
    failure = _failure(folder)
    if failure is not None:
        final = None
    held_out = settings.get("scene.held_out")
    threads = results.get("threads") or settings.get("train.threads")
    return RunRecord(
        folder=folder,
        method=method_of(command, settings),
        scene=str(results.get("scene") or _scene_name(settings)),
        views=_views(results, settings),
        seed=int(_number(results.get("seed", settings.get("seed"))) or 0),
        held_out=bool(results.get("held_out", held_out is not None)),
        evaluations=_evaluations(lines, final, settings.get("eval.pixels_stride") == 1),
        final=final,
        points_per_second=_number(results.get("points_per_second")),
        peak_memory_mb=_number(results.get("peak_memory_mb")),
        settings=settings,
        command=command,
        failure=failure,
        threads=threads if isinstance(threads, int) else None,
        versions={str(name): version for name, version in (results.get("versions") or {}).items()},
        finished=_written(folder / RESULTS) if final else None,
    )


def _evaluations(
    lines: Sequence[Mapping[str, Any]], final: Evaluation | None, full_size: bool
) -> tuple[Evaluation, ...]:
    """Those on the way, then the final one in place of the line that says the same."""
    on_the_way = [evaluation for line in lines if (evaluation := _evaluation(line, whole=False))]
    if final is None:
        return tuple(sorted(on_the_way, key=_time))
    kept = [
        replace(evaluation, whole=full_size and evaluation.views == final.views)
        for evaluation in on_the_way
        if evaluation.step < final.step
    ]
    return (*sorted(kept, key=_time), final)


def _time(evaluation: Evaluation) -> tuple[float, int]:
    return evaluation.train_seconds, evaluation.step


def _evaluation(line: Mapping[str, Any], whole: bool) -> Evaluation | None:
    step, seconds, views = (
        _number(line.get("step")),
        _number(line.get("train_seconds")),
        line.get("test_views"),
    )
    if step is None or seconds is None:
        return None
    return Evaluation(
        step=int(step),
        train_seconds=seconds,
        psnr=_number(line.get("psnr")),
        ssim=_number(line.get("ssim")),
        lpips=_number(line.get("lpips")),
        average=_number(line.get("average")),
        depth_rmse=_number(line.get("depth_rmse")),
        views=len(views) if isinstance(views, Mapping) else 0,
        whole=whole,
    )


def _failure(folder: Path) -> str | None:
    """The reason in `failed.json`, unless the run has been repeated since."""
    path = folder / FAILED
    failed, finished = _written(path), _written(folder / RESULTS)
    if failed is None or (finished is not None and finished > failed):
        return None
    content = _read_json(path)
    reason = ": ".join(str(content[key]) for key in ("error", "message") if content.get(key))
    return shorten(reason, LONGEST_REASON, placeholder=" ...") if reason else f"see {path}"


def _scene_name(settings: Mapping[str, object]) -> str:
    """What the scene will be called in `results.json`."""
    path, form = settings.get("scene.path"), settings.get("scene.format", "scene")
    if not path:
        return (
            f"{form}-{settings.get('scene.layout') or 'orbit'}"
            if form == "procedural"
            else str(form)
        )
    found = Path(str(path))
    return (found.parent if found.suffix == ".json" else found).name or str(form)


def _views(results: Mapping[str, Any], settings: Mapping[str, object]) -> int:
    """The number of training views; 0 where nobody has counted them yet."""
    counted = _number(results.get("views"))
    if counted is not None:
        return int(counted)
    given, listed, held_out = (
        settings.get(f"scene.{key}") for key in ("views", "train", "held_out")
    )
    views = len(listed) if isinstance(listed, list) and given is None else _number(given)
    return max(int(views or 0) - (len(held_out) if isinstance(held_out, list) else 0), 0)


def _views_counted(records: Sequence[RunRecord]) -> list[RunRecord]:
    """Where a run cannot say yet how many views it trains on, another run of its scene may know."""
    known = {
        (run.scene, run.held_out, run.settings.get("scene.split")): run.views
        for run in records
        if run.views
    }
    return [
        run
        if run.views
        else replace(
            run, views=known.get((run.scene, run.held_out, run.settings.get("scene.split")), 0)
        )
        for run in records
    ]


def _read_lines(path: Path) -> tuple[list[dict[str, Any]], bool]:
    """The JSON objects in a file, one a line, and whether some line is none (the last may be on its way)."""
    lines, torn = [], False
    for text in _read_text(path).splitlines():
        try:
            line = json.loads(text)
        except ValueError:
            torn = True
        else:
            if isinstance(line, dict):
                lines.append(line)
    return lines, torn


def _read_json(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(_read_text(path))
    except ValueError:
        return {}
    return content if isinstance(content, dict) else {}


def _read_yaml(path: Path) -> Any:
    try:
        return yaml.safe_load(_read_text(path))
    except yaml.YAMLError:
        return None


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def _written(path: Path) -> float | None:
    try:
        return path.stat().st_mtime
    except OSError:
        return None


def _flat(node: Any, prefix: str = "") -> dict[str, object]:
    """Nested keys joined by dots."""
    flat: dict[str, object] = {}
    for key, value in (node if isinstance(node, Mapping) else {}).items():
        flat.update(
            _flat(value, f"{prefix}{key}.")
            if isinstance(value, Mapping)
            else {f"{prefix}{key}": value}
        )
    return flat


def _number(value: object) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)


def _natural(name: str) -> list[tuple[int, int | str]]:
    """Sorts `2_b` before `10_a`."""
    return [
        (0, int(part)) if part.isdecimal() else (1, part)
        for part in re.split(r"(\d+)", name)
        if part
    ]

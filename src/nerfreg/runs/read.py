"""Read back what runs left in their folders, which may still be written meanwhile."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from textwrap import shorten
from typing import Any

import yaml

from nerfreg.runs import records
from nerfreg.runs.files import FAILED, METRICS, RECORDED_STEPS, RENDERS, RESULTS
from nerfreg.runs.records import EvaluationRecord, RunRecord
from nerfreg.scenes.layouts import FORWARD, ORBIT, stands_around

CONFIG, OVERRIDES = Path(".hydra", "config.yaml"), Path(".hydra", "overrides.yaml")
OTHER_VERB = "cameras.png"
"""Found in a folder with a configuration that `nerfreg scene` made and not `nerfreg train`."""
SCHEDULE = "schedule"
"""A key that every schedule has."""
LONGEST_REASON = 300
CONTENTS = (RENDERS, "checkpoint", RECORDED_STEPS)
"""Folders inside a run's folder, which hold no runs."""


def find_runs(place: Path) -> Iterator[Path]:
    """Yield the folders of training runs in `place`, jobs of a sweep in the order of their numbers.

    A run that has not been scored yet is one, too.
    """
    for root, names, files in os.walk(place):
        names[:] = [name for name in names if name not in CONTENTS and not name.startswith(".")]
        names.sort(key=_natural)
        trained = {METRICS, RESULTS, FAILED} & {*files} or OTHER_VERB not in files
        if trained and (Path(root) / CONFIG).is_file():
            yield Path(root)


def read_run_folder(folder: Path) -> RunRecord:
    """Return what a folder says. What is missing, half-written or null is None or left out."""
    results = _mapping(_parsed(folder / RESULTS, json.loads))
    settings = {
        **_flat(_parsed(folder / CONFIG, yaml.safe_load)),
        **_flat(results.get("regularizers"), "reg."),
    }
    command = tuple(map(str, _parsed(folder / OVERRIDES, yaml.safe_load) or ()))
    lines, torn = _read_lines(folder / METRICS)
    final = _evaluation(results, whole=True)
    if final and lines and not torn and lines[-1].get("step") != final.step:
        # They are of an earlier run in the same folder, which is being repeated.
        final, results = None, {}
    failure = _failure(folder)
    if failure is not None:
        final = None
    held_out = bool(results.get("held_out", settings.get("scene.held_out") is not None))
    scene = str(results.get("scene") or _scene_name(settings))
    threads = results.get("threads") or settings.get("train.threads")
    return RunRecord(
        folder=folder,
        scene=scene,
        views=_views(results, settings),
        held_out=held_out,
        seed=int(_number(results.get("seed", settings.get("seed"))) or 0),
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
    lines: Sequence[Mapping[str, Any]], final: EvaluationRecord | None, full_size: bool
) -> tuple[EvaluationRecord, ...]:
    found = [each for line in lines if (each := _evaluation(line, whole=False))]
    found.sort(key=lambda each: (each.train_seconds, each.step))
    if final is None:
        return tuple(found)
    # The line of the last step says the same as the final evaluation, which takes its place.
    before = [each for each in found if each.step < final.step]
    return (*(replace(e, whole=full_size and e.views == final.views) for e in before), final)


def _evaluation(line: Mapping[str, Any], whole: bool) -> EvaluationRecord | None:
    step, seconds = _number(line.get("step")), _number(line.get("train_seconds"))
    if step is None or seconds is None:
        return None
    scores: dict[str, Any] = {metric: _number(line.get(metric)) for metric in records.METRICS}
    listed = line.get("test_views")
    views = len(listed) if isinstance(listed, Mapping) else 0
    measured = {
        str(name): number
        for name, value in _mapping(line.get("metrics")).items()
        if (number := _number(value)) is not None
    }
    record = EvaluationRecord(int(step), seconds, views=views, whole=whole, metrics=measured)
    return replace(record, **scores)


def _failure(folder: Path) -> str | None:
    """Return the reason in `failed.json`, unless the run has been repeated since."""
    path = folder / FAILED
    failed, finished = _written(path), _written(folder / RESULTS)
    if failed is None or (finished is not None and finished > failed):
        return None
    content = _mapping(_parsed(path, json.loads))
    reason = ": ".join(str(content[key]) for key in ("error", "message") if content.get(key))
    return shorten(reason, LONGEST_REASON, placeholder=" ...") if reason else f"see {path}"


def _scene_name(settings: Mapping[str, Any]) -> str:
    """Return what the scene will be called in `results.json`."""
    path, form = settings.get("scene.path"), str(settings.get("scene.format", "scene"))
    if path:
        found = Path(str(path))
        return (found.parent if found.suffix == ".json" else found).name or form
    around = stands_around(settings.get("scene.layout") or ORBIT)
    return f"{form}-{ORBIT if around else FORWARD}" if form == "procedural" else form


def _views(results: Mapping[str, Any], settings: Mapping[str, Any]) -> int:
    """Return the number of training views, or 0 where nobody has counted them yet."""
    counted = _number(results.get("views"))
    if counted is not None:
        return int(counted)
    keys = ("views", "train", "held_out")
    given, listed, held_out = (settings.get(f"scene.{key}") for key in keys)
    views = len(listed) if isinstance(listed, list) and given is None else _number(given)
    return max(int(views or 0) - (len(held_out) if isinstance(held_out, list) else 0), 0)


def _read_lines(path: Path) -> tuple[list[dict[str, Any]], bool]:
    """Return the JSON objects in a file, one a line, and whether a line could not be read.

    The last line may be half-written.
    """
    lines, torn = [], False
    for text in (_parsed(path, str) or "").splitlines():
        try:
            lines.append(json.loads(text))
        except ValueError:
            torn = True
    return [line for line in lines if isinstance(line, dict)], torn


def _parsed(path: Path, parse: Callable[[str], Any]) -> Any:
    """Return what is in a file, or None if it cannot be read."""
    try:
        return parse(path.read_text(encoding="utf-8", errors="replace"))
    except (OSError, ValueError, yaml.YAMLError):
        return None


def _written(path: Path) -> float | None:
    try:
        return path.stat().st_mtime
    except OSError:
        return None


def _mapping(value: object) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _flat(node: Any, prefix: str = "") -> dict[str, Any]:
    """Join nested keys by dots; a schedule is one value."""
    flat: dict[str, Any] = {}
    for key, value in _mapping(node).items():
        name = f"{prefix}{key}"
        nested = isinstance(value, Mapping) and SCHEDULE not in value
        flat |= _flat(value, f"{name}.") if nested else {name: value}
    return flat


def _number(value: object) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)


def _natural(name: str) -> list[tuple[int, int | str]]:
    """Return a key that sorts `2_b` before `10_a`."""
    parts = filter(None, re.split(r"(\d+)", name))
    return [(0, int(part)) if part.isdecimal() else (1, part) for part in parts]

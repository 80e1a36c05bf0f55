"""All runs in some folders, named so that different methods differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from nerfreg.errors import NerfregError
from nerfreg.reports.methods import distinguished, method_of, scenes_distinguished
from nerfreg.reports.records import NamedRun
from nerfreg.runs.files import METRICS, RESULTS
from nerfreg.runs.read import CONFIG, find_runs, read_run_folder


def collect(places: Sequence[Path]) -> list[NamedRun]:
    """Return all runs in folders and in the folders below them, each once.

    They are named so that different methods have different names.

    Raises:
        NerfregError: A path is no folder, or no run is found at all.
    """
    folders: dict[Path, Path] = {}
    for place in places:
        if not place.is_dir():
            problem = "is a file; name a folder of runs" if place.exists() else "does not exist"
            raise NerfregError(f"{place}: {problem}")
        for folder in find_runs(place):
            folders.setdefault(folder.resolve(), folder)
    if not folders:
        searched = ", ".join(map(str, places))
        needed = f"a run has {CONFIG} and {METRICS} or {RESULTS}"
        raise NerfregError(f"{searched}: no run found ({needed})")
    found = map(read_run_folder, folders.values())
    runs = [NamedRun(**vars(run), method=method_of(run.command, run.settings)) for run in found]
    return distinguished(scenes_distinguished(_views_counted(runs)))


def _views_counted(runs: Sequence[NamedRun]) -> list[NamedRun]:
    """Let a run that cannot say yet how many views it trains on ask the others of its scene."""

    def key(run: NamedRun) -> tuple[object, ...]:
        return run.scene, run.held_out, run.settings.get("scene.split")

    known = {key(run): run.views for run in runs if run.views}
    return [run if run.views else replace(run, views=known.get(key(run), 0)) for run in runs]

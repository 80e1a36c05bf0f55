"""Score the checkpoint of a run again."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from nerfreg.evaluation.lpips import load_lpips
from nerfreg.evaluation.scores import score_views
from nerfreg.runs.files import RESULTS, write_results
from nerfreg.runs.load import load_run
from nerfreg.runs.pictures import saving
from nerfreg.runs.results import description, per_view, summary


def evaluate_run(run: Path, overrides: Sequence[str] = ()) -> dict[str, Any]:
    """Score the checkpoint of a run on all its test views, and replace its pictures and results.

    Args:
        run: The run's folder.
        overrides: `key=value` changes of the saved configuration.

    Returns:
        What `results.json` holds.

    Raises:
        NerfregError: There is no run, its plugins are not installed, or its weights do not fit.
    """
    loaded = load_run(run, overrides)
    config, scene, state, trained = loaded.config, loaded.scene, loaded.state, loaded.trained
    lpips = load_lpips(config.eval.lpips_weights) if config.eval.lpips else None
    render = saving(trained, config.eval.save_renders, run)
    scores = score_views(scene, scene.test, render, lpips, measure=trained.measure)
    # The losses of the last step are not known here; all else is as after training.
    results = {
        **state.record(),
        **scores.record(),
        "points_per_second": state.points / max(state.train_seconds, 1e-9),
        "test_views": per_view(scene, scores),
        **description(config, scene),
    }
    write_results(run, results)
    for line in summary(results):
        print(line)
    print(run / RESULTS)
    return results

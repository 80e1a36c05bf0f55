"""Weights and losses of short runs, held across commits.

The values in `golden.json` are made by `python tests/test_golden.py`. Record them anew only in a
commit that is meant to change what training computes, and say so in its message.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from safetensors.torch import load_file

from nerfreg.cli import main

GOLDEN = Path(__file__).with_name("golden.json")
CONF = Path(__file__).parents[1] / "conf"
TINY = (
    "scene.size=32", "scene.test_views=1", "train.steps=24", "train.rays=96", "train.quiet=true",
    "train.threads=1", "sampler.coarse=12", "sampler.fine=12", "field.levels=4", "field.finest=64",
    "field.log2_entries=11",
    "eval.lpips=false", "eval.count=1", "eval.save_renders=0",
)  # fmt: skip
PRESETS = sorted(path.stem for path in (CONF / "reg").glob("*.yaml"))
ALONE = ("adversarial", "annealing", "entropy")
"""Plugins that no preset contains."""
CASES = {
    **{
        f"{name} {layout}": (f"+reg={name}", f"scene.layout={layout}")
        for name in PRESETS
        for layout in ("orbit",)
    },
    **{f"{name} orbit": (f"+reg={name}", "scene.layout=orbit") for name in ALONE},
    **{
        f"{name} forward": (f"+reg={name}", "scene.layout=forward")
        for name in ("combinerf", "combinerf_plus")
    },
}
TOLERANCE = 1e-3
"""Relative. Sums are added in another order where a processor has other vector instructions, and
two dozen steps of Adam amplify such differences; changes of an algorithm are far above it."""


def figures(folder: Path, overrides: tuple[str, ...]) -> dict[str, Any]:
    """Scores and losses of a run that is trained here, and the norm of each of its parameters."""
    assert main(["train", *TINY, *overrides, f"hydra.run.dir={folder}"]) == 0
    results = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    weights = load_file(folder / "checkpoint" / "field.safetensors")
    return {
        "step": results["step"],
        "points": results["points"],
        "psnr": results["psnr"],
        "losses": results["losses"],
        "norms": {name: float(tensor.double().norm()) for name, tensor in sorted(weights.items())},
    }


def test_every_preset_has_golden_values() -> None:
    assert list(json.loads(GOLDEN.read_text(encoding="utf-8"))) == list(CASES)


@pytest.mark.parametrize("case", CASES)
def test_run_is_what_it_was(case: str, tmp_path: Path) -> None:
    golden = json.loads(GOLDEN.read_text(encoding="utf-8"))[case]
    found = figures(tmp_path, CASES[case])
    assert (found["step"], found["points"]) == (golden["step"], golden["points"])
    assert found["psnr"] == pytest.approx(golden["psnr"], rel=TOLERANCE)
    assert found["losses"] == pytest.approx(golden["losses"], rel=TOLERANCE, abs=1e-9)
    assert found["norms"] == pytest.approx(golden["norms"], rel=TOLERANCE)


def record() -> None:
    """Write the values of all cases."""
    recorded = {}
    for case, overrides in CASES.items():
        with TemporaryDirectory() as folder:
            recorded[case] = figures(Path(folder), overrides)
    GOLDEN.write_text(json.dumps(recorded, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(record())

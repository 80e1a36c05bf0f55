"""Make docs/teaser.jpg, the picture at the head of the README: two runs on the procedural scene.

    python docs/make_teaser.py RUNS

trains `RUNS/vanilla` and `RUNS/combinerf_plus` with all defaults, unless they are there already,
and shows the test view whose gain in PSNR is the median of all test views.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import matplotlib
import numpy as np

METHODS = ("vanilla", "combinerf_plus")
PICTURE = Path(__file__).parent / "teaser.jpg"
TEXT = {"fontsize": 8.5, "pad": 4}


def train(folder: Path) -> dict[str, Any]:
    """Train the method that the folder is named after, unless it has results; returns these."""
    results = folder / "results.json"
    if not results.is_file():
        command = [sys.executable, "-m", "nerfreg", "train", f"+reg={folder.name}"]
        subprocess.run([*command, f"hydra.run.dir={folder}"], check=True)
    content: dict[str, Any] = json.loads(results.read_text(encoding="utf-8"))
    return content


def median_view(scores: dict[str, dict[str, Any]]) -> str:
    """The test view in whose gain half of the others are behind, and half ahead."""
    before, after = (scores[method]["test_views"] for method in METHODS)
    ordered = sorted(before, key=lambda view: after[view]["psnr"] - before[view]["psnr"])
    return ordered[len(ordered) // 2]


def panels(folder: Path, view: str) -> list[np.ndarray]:
    """Colour, depth, photograph and error of one test view, which a run saves in one picture."""
    picture = iio.imread(folder / "renders" / f"{view.replace('/', '_')}.png")
    return np.split(picture, 4, axis=1)


def training_images() -> np.ndarray:
    """The eight training images on white, in four rows of two."""
    from nerfreg.scenes import Procedural

    images = Procedural().load().photographs().images.numpy()
    colors = images[..., :3] * images[..., 3:] + 1 - images[..., 3:]
    rows = [np.concatenate(colors[i : i + 2], axis=1) for i in range(0, 8, 2)]
    return np.concatenate(rows, axis=0)


def draw(runs: Path) -> None:
    """Lay the panels out side by side and write the picture."""
    matplotlib.use("agg")
    from matplotlib import pyplot

    scores = {method: train(runs / method) for method in METHODS}
    view = median_view(scores)
    psnr = {method: scores[method]["test_views"][view]["psnr"] for method in METHODS}
    color, depth, photograph = {}, {}, np.zeros(0)
    for method in METHODS:
        color[method], depth[method], photograph, _ = panels(runs / method, view)
    titled = [
        ("training", training_images()),
        ("test view, ground truth", photograph),
        *((f"{method}, {psnr[method]:.1f} dB", color[method]) for method in METHODS),
        *((f"depth, {method}", depth[method]) for method in METHODS),
    ]
    ratios = [image.shape[1] / image.shape[0] for _, image in titled]
    figure, axes = pyplot.subplots(
        1, len(titled), figsize=(2 * sum(ratios), 2.2), width_ratios=ratios, layout="constrained"
    )
    for axis, (title, image) in zip(axes, titled, strict=True):
        axis.imshow(image, interpolation="bicubic")
        axis.set_title(title, **TEXT)
        axis.axis("off")
    figure.savefig(PICTURE, dpi=140, pil_kwargs={"quality": 88})
    for method in METHODS:
        names = ("psnr", "ssim", "lpips", "depth_rmse")
        print(method, *(f"{name} {scores[method][name]:.3f}" for name in names))
    print(f"{PICTURE}: {view}")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    draw(Path(sys.argv[1]))

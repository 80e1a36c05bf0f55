"""Pictures and videos of a run."""

from __future__ import annotations

from pathlib import Path

from nerfreg.evaluation.images import depth_image
from nerfreg.evaluation.paths import orbit_path, spiral_path
from nerfreg.evaluation.video import write_video
from nerfreg.runs.load import load_run
from nerfreg.runs.pictures import save_view


def render_run(
    run: Path, path: str, out: Path, frames: int = 60, fps: float = 30.0, format: str = "gif"
) -> None:
    """Render the test views of a run to PNG, or a camera path to videos of colour and depth.

    Args:
        run: The run's folder.
        path: "test" for the test views, else the camera path: "spiral" or "orbit".
        out: Folder of the pictures or videos.
        frames: Number of frames of a video.
        fps: Frames per second.
        format: "mp4" or "gif".

    Raises:
        NerfregError: There is no run, its plugins are not installed, or its weights do not fit.
    """
    trained = load_run(run).trained
    renderer, scene = trained.renderer(), trained.scene
    if path == "test":
        for view in scene.test:
            save_view(out, scene, view, renderer.view(scene.cameras, view))
        print(out)
        return
    cameras = (spiral_path if path == "spiral" else orbit_path)(scene, frames)
    views = [renderer.view(cameras, frame) for frame in range(frames)]
    colors = (view.rgb for view in views)
    depths = (depth_image(view.depth, scene.near, scene.far, view.opacity) for view in views)
    write_video(out / f"{path}_color.{format}", colors, fps)
    write_video(out / f"{path}_depth.{format}", depths, fps)
    print(out)

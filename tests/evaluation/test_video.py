from __future__ import annotations

import subprocess
import sys

import imageio.v3 as iio
import numpy as np
import pytest
import torch

from nerfreg.errors import NerfregError
from nerfreg.evaluation.video import write_video


def grays(count: int, height: int = 16, width: int = 24) -> list[torch.Tensor]:
    return [torch.full((height, width, 3), (i + 1) / (count + 1)) for i in range(count)]


def test_gif_has_all_frames_in_order_and_never_ends(tmp_path):
    path = tmp_path / "video.gif"
    write_video(path, iter(grays(4)), fps=10)
    frames = iio.imread(path)
    assert frames.shape == (4, 16, 24, 3)
    # grays 1/5 .. 4/5 are bytes 51, 102, 153, 204; the palette may move them a little
    assert frames.mean((1, 2, 3)) == pytest.approx([51, 102, 153, 204], abs=3)
    about = iio.immeta(path)
    assert about["duration"] == 100
    assert about["loop"] == 0


def test_mp4_has_all_frames_and_even_sides(tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="mp4 needs imageio-ffmpeg (extra: video)")
    path = tmp_path / "video.mp4"
    write_video(path, grays(5, height=33, width=47), fps=25)
    # decoded by ffmpeg itself: imageio's reader leaves its pipes open, which counts as an error
    # here
    command = [
        ffmpeg.get_ffmpeg_exe(),
        "-v",
        "error",
        "-i",
        path,
        "-f",
        "rawvideo",
        "-pix_fmt",
        "rgb24",
        "-",
    ]
    raw = subprocess.run(command, capture_output=True, check=True).stdout
    # 33 x 47 is padded to 34 x 48; a video of another size or length would not have as many bytes
    frames = np.frombuffer(raw, np.uint8).reshape(5, 34, 48, 3)
    assert np.all(np.diff(frames.mean((1, 2, 3))) > 20)
    assert [p.name for p in tmp_path.iterdir()] == ["video.mp4"]


def test_mp4_without_ffmpeg_says_what_to_install_before_anything_is_rendered(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)

    def frames():
        raise AssertionError("rendered in vain")
        yield

    with pytest.raises(NerfregError, match=r"pip install nerfreg\[video\]"):
        write_video(tmp_path / "video.mp4", frames())
    assert not list(tmp_path.iterdir())


def test_other_formats_and_empty_videos_are_refused(tmp_path):
    with pytest.raises(NerfregError, match=r"video\.avi.*\.gif or \.mp4"):
        write_video(tmp_path / "video.avi", grays(1))
    with pytest.raises(NerfregError, match="no frames"):
        write_video(tmp_path / "video.gif", [])
    assert not list(tmp_path.iterdir())


def test_a_video_that_breaks_off_is_not_left_behind(tmp_path):
    def frames():
        yield grays(1)[0]
        raise RuntimeError("out of memory")

    with pytest.raises(RuntimeError):
        write_video(tmp_path / "video.gif", frames())
    assert not list(tmp_path.iterdir())

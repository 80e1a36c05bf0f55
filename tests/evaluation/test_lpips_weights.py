from __future__ import annotations

import hashlib
import http.server
import socket
import threading
import time
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from nerfreg.errors import NerfregError
from nerfreg.evaluation import lpips_weights
from nerfreg.evaluation.lpips_weights import CHECKPOINT, find_lpips_weights


@pytest.fixture(autouse=True)
def empty_hub(tmp_path, monkeypatch):
    """A torch hub cache with nothing in it, and no network."""
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "torch"))
    monkeypatch.delenv("NERFREG_DATA", raising=False)
    monkeypatch.setattr(lpips_weights, "CHECKPOINT_URL", "http://127.0.0.1:9/nothing")
    monkeypatch.setattr(lpips_weights, "CONNECT_SECONDS", 0.5)
    lpips_weights._download.cache_clear()
    return tmp_path / "torch" / "hub" / "checkpoints"


@pytest.fixture
def serve(tmp_path):
    """Serve a folder on this machine; returns its address."""
    folder = tmp_path / "served"
    folder.mkdir()

    class Handler(http.server.SimpleHTTPRequestHandler):
        def __init__(self, *args):
            super().__init__(*args, directory=str(folder))

        def log_message(self, *args):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield folder, f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


def test_a_configured_file_comes_first(tmp_path, monkeypatch):
    mine = tmp_path / "mine.safetensors"
    mine.touch()
    shared = tmp_path / "lpips" / "alexnet_v0.1.safetensors"
    shared.parent.mkdir()
    shared.touch()
    monkeypatch.setenv("NERFREG_DATA", str(tmp_path))
    assert find_lpips_weights(str(mine)) == mine
    assert find_lpips_weights(None) == shared


def test_a_configured_file_that_is_missing_is_an_error_though_others_exist(tmp_path, monkeypatch):
    shared = tmp_path / "lpips" / "alexnet_v0.1.safetensors"
    shared.parent.mkdir()
    shared.touch()
    monkeypatch.setenv("NERFREG_DATA", str(tmp_path))
    with pytest.raises(NerfregError, match=r"eval\.lpips_weights=nowhere\.safetensors"):
        find_lpips_weights("nowhere.safetensors")


def test_no_file_and_no_network_is_none_in_silence(capfd, caplog):
    assert find_lpips_weights(None) is None
    assert capfd.readouterr() == ("", "")
    assert not caplog.records


def test_a_server_that_never_answers_is_given_up(monkeypatch, empty_hub):
    with socket.create_server(("127.0.0.1", 0)) as mute:
        monkeypatch.setattr(
            lpips_weights, "CHECKPOINT_URL", f"http://127.0.0.1:{mute.getsockname()[1]}/x"
        )
        started = time.monotonic()
        assert find_lpips_weights(None) is None
        assert time.monotonic() - started < 3.0
    assert not list(empty_hub.glob("*"))


def test_alexnet_of_torch_hub_and_heads_of_torchmetrics_are_the_published_weights(
    data: Path, empty_hub
):
    published = load_file(data / "lpips" / "alexnet_v0.1.safetensors")
    empty_hub.mkdir(parents=True)
    checkpoint = {"classifier.1.weight": torch.zeros(2, 2)}
    for i, place in enumerate((0, 3, 6, 8, 10)):
        checkpoint[f"features.{place}.weight"] = published[f"conv{i}.weight"]
        checkpoint[f"features.{place}.bias"] = published[f"conv{i}.bias"]
    torch.save(checkpoint, empty_hub / CHECKPOINT)

    path = find_lpips_weights(None)

    assert path is not None
    joined = load_file(path)
    assert joined.keys() == published.keys()
    assert all(torch.equal(joined[name], published[name]) for name in published)
    (empty_hub / CHECKPOINT).unlink()
    assert find_lpips_weights(None) == path  # kept for the next time


def test_a_damaged_checkpoint_is_none_and_says_which_file(empty_hub, caplog):
    empty_hub.mkdir(parents=True)
    (empty_hub / CHECKPOINT).write_bytes(b"damaged")
    assert find_lpips_weights(None) is None
    assert CHECKPOINT in caplog.text
    assert [p.name for p in empty_hub.iterdir()] == [CHECKPOINT]


def test_download_checks_the_sum_in_the_name_and_leaves_nothing_else(serve, tmp_path):
    folder, address = serve
    content = b"weights" * 100
    (folder / "file").write_bytes(content)
    digest = hashlib.sha256(content).hexdigest()[:8]
    right, wrong = tmp_path / "got" / f"net-{digest}.pth", tmp_path / "got" / "net-00000000.pth"
    assert lpips_weights._download(f"{address}/file", right)
    assert right.read_bytes() == content
    assert not lpips_weights._download(f"{address}/file", wrong)
    assert not lpips_weights._download(f"{address}/missing", wrong)
    assert [p.name for p in right.parent.iterdir()] == [right.name]

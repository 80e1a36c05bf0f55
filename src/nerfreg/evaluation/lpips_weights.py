"""Find the weights of LPIPS: a configured file, the data folder, or torch hub and torchmetrics."""

from __future__ import annotations

import hashlib
import importlib.util
import logging
import os
import pickle
import threading
from functools import cache
from http.client import HTTPException
from pathlib import Path
from urllib.request import urlopen

import torch
from safetensors.torch import save_file

from nerfreg.errors import NerfregError
from nerfreg.files import atomic

log = logging.getLogger(__name__)

LAYERS = 5
"""Number of AlexNet's convolutions, each with a linear head."""

WEIGHTS_NAME = "alexnet_v0.1.safetensors"
CHECKPOINT = "alexnet-owt-7be5be79.pth"
CHECKPOINT_URL = f"https://download.pytorch.org/models/{CHECKPOINT}"
ALEXNET_FEATURES = (0, 3, 6, 8, 10)
"""Indices of the five convolutions among the layers of torchvision's AlexNet."""

CONNECT_SECONDS = 5.0
DOWNLOAD_SECONDS = 60.0
"""How long a run waits at most for a server to answer, and then for the whole file."""

HOW_TO_GET_WEIGHTS = (
    f"LPIPS and average are n/a because no weights were found: download {CHECKPOINT_URL} into "
    "~/.cache/torch/hub/checkpoints, or set eval.lpips_weights=FILE.safetensors"
)


def find_lpips_weights(configured: str | None) -> Path | None:
    """Find the weights of LPIPS.

    Looks for the configured file, then in `$NERFREG_DATA/lpips/`, and then joins AlexNet from torch
    hub's cache or server with the heads that torchmetrics ships, and keeps that file in the cache.

    Args:
        configured: The value of `eval.lpips_weights`.

    Returns:
        The file; None if there are no weights.

    Raises:
        NerfregError: If the configured file does not exist.
    """
    if configured is not None:
        path = Path(configured).expanduser()
        if not path.is_file():
            raise NerfregError(
                f"eval.lpips_weights={configured}: no such file; "
                "leave it null to look for the weights"
            )
        return path
    data = os.environ.get("NERFREG_DATA")
    if data and (path := Path(data) / "lpips" / WEIGHTS_NAME).is_file():
        return path
    return _join_published_weights(Path(torch.hub.get_dir()) / "checkpoints")


def _join_published_weights(folder: Path) -> Path | None:
    """Put torch hub's AlexNet and torchmetrics' heads into one safetensors file in `folder`."""
    joined, checkpoint = folder / f"lpips_{WEIGHTS_NAME}", folder / CHECKPOINT
    if joined.is_file():
        return joined
    heads_file = _torchmetrics_heads()
    # The heads come first: without them the download would be for nothing.
    if heads_file is None or not (checkpoint.is_file() or _download(CHECKPOINT_URL, checkpoint)):
        return None
    try:
        alexnet = torch.load(checkpoint, map_location="cpu", weights_only=True)
        heads = torch.load(heads_file, map_location="cpu", weights_only=True)
        tensors = {}
        for i, place in enumerate(ALEXNET_FEATURES):
            tensors[f"conv{i}.weight"] = alexnet[f"features.{place}.weight"].contiguous()
            tensors[f"conv{i}.bias"] = alexnet[f"features.{place}.bias"].contiguous()
            tensors[f"lin{i}.weight"] = heads[f"lin{i}.model.1.weight"].contiguous()
        with atomic(joined) as part:
            save_file(tensors, part)
    # A broken file in the cache costs two scores and must not cost the run.
    except (
        OSError,
        RuntimeError,
        KeyError,
        EOFError,
        pickle.UnpicklingError,
        NerfregError,
    ) as error:
        log.warning("%s: cannot be used for LPIPS (%s)", checkpoint, str(error).splitlines()[0])
        return None
    return joined


def _torchmetrics_heads() -> Path | None:
    # `find_spec` locates the package without importing it, which takes long.
    package = importlib.util.find_spec("torchmetrics")
    if package is None or package.origin is None:
        return None
    path = Path(package.origin).parent / "functional" / "image" / "lpips_models" / "alex.pth"
    return path if path.is_file() else None


@cache
def _download(url: str, path: Path) -> bool:
    """Download a file, and tell whether it arrived in time.

    Tried once per process, since a sweep without a network would wait again in every run. The work
    is done in a thread that can be abandoned, since looking up a host name has no timeout.
    """
    connected, finished, abandoned = threading.Event(), threading.Event(), threading.Event()

    def fetch() -> None:
        digest = hashlib.sha256()
        try:
            with (
                urlopen(url, timeout=CONNECT_SECONDS) as response,
                atomic(path) as part,
                part.open("wb") as file,
            ):
                connected.set()
                log.info("downloading %s (233 MB, once), for LPIPS", url)
                while chunk := response.read(1 << 20):
                    if abandoned.is_set():
                        raise TimeoutError
                    file.write(chunk)
                    digest.update(chunk)
                # torch hub's names end with the first digits of the SHA-256 digest.
                if not digest.hexdigest().startswith(path.stem.rpartition("-")[2]):
                    raise OSError("checksum")
            finished.set()
        except (OSError, HTTPException, NerfregError):
            # There is nothing more to wait for; `finished` stays unset.
            connected.set()

    thread = threading.Thread(target=fetch, daemon=True)
    thread.start()
    if connected.wait(CONNECT_SECONDS):
        thread.join(DOWNLOAD_SECONDS)
    abandoned.set()
    return finished.is_set()

"""`nerfreg cite RUN`: the sources of everything that a run used."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

from omegaconf import OmegaConf

from nerfreg.errors import NerfregError, nearest
from nerfreg.hooks import Regularizer
from nerfreg.registry import installed
from nerfreg.registry.plugin_fields import PLUGIN_KEY
from nerfreg.registry.plugins import find_plugin

BIBLIOGRAPHY = "references.bib"
"""File in a package that holds the BibTeX entries its plugins name by their keys."""

CORE = "mildenhall2020nerf, muller2022instant, kingma2015adam"
LPIPS = "zhang2018unreasonable"


def cite(run: Path) -> str:
    """Return the BibTeX entries of the core and of the run's plugins, each once.

    Args:
        run: Folder of the run.

    Raises:
        NerfregError: The run's configuration cannot be read, or the sources of one of its plugins
            cannot be found.
    """
    path = run / ".hydra" / "config.yaml"
    try:
        config = OmegaConf.load(path)
        selected = {
            str(name): str(OmegaConf.select(settings, PLUGIN_KEY, default=name))
            for name, settings in OmegaConf.select(config, "reg", default={}).items()
        }
        with_lpips = bool(OmegaConf.select(config, "eval.lpips", default=False))
    except Exception as error:
        raise NerfregError(
            f"{path}: not the configuration of a run ({type(error).__name__})"
        ) from error
    known = installed()
    entries = _core_entries(with_lpips)
    for name, address in selected.items():
        plugin = find_plugin(address, known)
        if plugin is None or plugin.cls is None:
            raise NerfregError(
                f"{path}: reg.{name} is not installed here, its source cannot be told"
            )
        entries |= plugin_entries(name, plugin.cls)
    return "\n\n".join(entries.values())


def plugin_entries(name: str, cls: type[Regularizer]) -> dict[str, str]:
    """Return the BibTeX entries of one plugin by their keys.

    Its `cite` is either BibTeX text or a list of keys, separated by commas. Keys are looked up in
    the file `references.bib` of the package that holds the plugin's module, or of the closest
    parent package that has such a file.

    Args:
        name: What the plugin is called in a configuration, for messages.
        cls: The plugin's class.

    Raises:
        NerfregError: A key is not in the file, or there is no file.
    """
    if "@" in cls.cite:
        return _entries(cls.cite)
    if not cls.cite.strip():
        return {}
    # A subclass in another package inherits `cite`, but the keys belong to the package whose
    # class wrote them down.
    owner = next(base for base in cls.__mro__ if "cite" in vars(base))
    package = sys.modules[owner.__module__].__package__ or ""
    file = next((found for found in _bibliographies(package) if found.is_file()), None)
    if file is None:
        raise NerfregError(
            f"plugin {name}: cites '{cls.cite}', but there is no {BIBLIOGRAPHY} "
            f"in the package of {owner.__module__} or a parent of it"
        )
    return _picked(f"plugin {name}", cls.cite, file)


def _core_entries(with_lpips: bool) -> dict[str, str]:
    keys = f"{CORE}, {LPIPS}" if with_lpips else CORE
    return _picked("nerfreg", keys, files("nerfreg.runs") / BIBLIOGRAPHY)


def _bibliographies(package: str) -> Iterator[Traversable]:
    while package:
        yield files(package) / BIBLIOGRAPHY
        package = package.rpartition(".")[0]


def _picked(who: str, keys: str, file: Traversable) -> dict[str, str]:
    entries = _entries(file.read_text(encoding="utf-8"))
    picked = {}
    for key in filter(None, map(str.strip, keys.split(","))):
        if key not in entries:
            raise NerfregError(f"{who}: cites '{key}', not in {file}; {nearest(key, entries)}")
        picked[key] = entries[key]
    return picked


def _entries(text: str) -> dict[str, str]:
    # An entry begins with @ at the start of a line; BibTeX ignores what stands before the first.
    parts = re.split(r"^[ \t]*(?=@)", text, flags=re.MULTILINE)
    entries = [part.strip() for part in parts if part.startswith("@")]
    return {entry.partition("{")[2].partition(",")[0].strip(): entry for entry in entries}

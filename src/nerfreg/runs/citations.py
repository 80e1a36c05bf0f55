"""`nerfreg cite RUN`: the sources of everything that a run used."""

from __future__ import annotations

import re
from pathlib import Path

from omegaconf import OmegaConf

from nerfreg.errors import NerfregError
from nerfreg.registry import installed

CORE = """@inproceedings{mildenhall2020nerf,
  title = {{NeRF}: Representing Scenes as Neural Radiance Fields for View Synthesis},
  author = {Mildenhall, Ben and Srinivasan, Pratul P. and Tancik, Matthew and Barron, Jonathan T. and Ramamoorthi, Ravi
            and Ng, Ren},
  booktitle = {ECCV},
  year = {2020}
}

@article{muller2022instant,
  title = {Instant Neural Graphics Primitives with a Multiresolution Hash Encoding},
  author = {M{\\"u}ller, Thomas and Evans, Alex and Schied, Christoph and Keller, Alexander},
  journal = {ACM Transactions on Graphics},
  volume = {41},
  number = {4},
  pages = {102:1--102:15},
  year = {2022}
}

@inproceedings{kingma2015adam,
  title = {Adam: A Method for Stochastic Optimization},
  author = {Kingma, Diederik P. and Ba, Jimmy},
  booktitle = {ICLR},
  year = {2015}
}"""

LPIPS = """@inproceedings{zhang2018unreasonable,
  title = {The Unreasonable Effectiveness of Deep Features as a Perceptual Metric},
  author = {Zhang, Richard and Isola, Phillip and Efros, Alexei A. and Shechtman, Eli and Wang, Oliver},
  booktitle = {CVPR},
  year = {2018}
}"""


def cite(run: Path) -> str:
    """BibTeX entries of the core and of the run's plugins, each once.

    Raises NerfregError where the run's configuration cannot be read.
    """
    path = run / ".hydra" / "config.yaml"
    try:
        config = OmegaConf.load(path)
        selected = list(OmegaConf.select(config, "reg", default={}))
        with_lpips = bool(OmegaConf.select(config, "eval.lpips", default=False))
    except Exception as error:
        raise NerfregError(
            f"{path}: not the configuration of a run ({type(error).__name__})"
        ) from error
    known = {plugin.name: plugin for plugin in installed()}
    texts = [CORE, LPIPS] if with_lpips else [CORE]
    for name in selected:
        plugin = known.get(name)
        if plugin is None or plugin.cls is None:
            raise NerfregError(
                f"{path}: reg.{name} is not installed here, its source cannot be told"
            )
        texts.append(plugin.cls.cite)
    entries = [entry for text in texts for entry in _entries(text)]
    return "\n\n".join(dict(entries).values())


def _entries(text: str) -> list[tuple[str, str]]:
    """(key, entry) pairs: an entry begins with @ at the start of a line."""
    entries = [
        entry.strip() for entry in re.split(r"^(?=@)", text, flags=re.MULTILINE) if entry.strip()
    ]
    return [(entry.partition("{")[2].partition(",")[0].strip(), entry) for entry in entries]

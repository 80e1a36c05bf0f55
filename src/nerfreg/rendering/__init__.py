"""From rays to pixels: where to sample, how samples are composited, and whole images.

Nothing here knows a loss. In the order in which a training step uses them:

- `config`: the options of the sampler.
- `emptiness`: which parts of rays plugins leave to be sampled.
- `sampling`: distances along rays, and the intervals around them.
- `spans`: samples by the length of what is left, and gaps as intervals of their own.
- `compositing`: the rendering integral, and the one function that makes a `Rendering`.
- `field_values`: the field at the samples of each ray.
- `renderer`: the rendering of a training step, through the hooks.

Images of a trained field are rendered another way:

- `occupancy`: the parts of the box that are empty.
- `blocks`, `scouts`: rays in blocks of pixels, and where such a block has density.
- `views`: whole images.
"""

from nerfreg.rendering.compositing import Composite, composite
from nerfreg.rendering.config import SamplerConfig

__all__ = ["Composite", "SamplerConfig", "composite"]

"""A field with everything that the plugins of a run put into it."""

from __future__ import annotations

from nerfreg.field import FieldConfig, RadianceField
from nerfreg.field.radiance_field import FieldParts
from nerfreg.registry.hooks import Hooks
from nerfreg.scenes.scene import SceneInfo


def make_field(config: FieldConfig, scene: SceneInfo, hooks: Hooks) -> RadianceField:
    """Build a field with fresh weights: encoders, layers, then modules of the plugins.

    Args:
        config: Sizes and implementations.
        scene: What is known of the scene.
        hooks: The hooks of the run.
    """
    encoders = {
        which: encoder
        for which in ("positions", "directions")
        if (encoder := hooks.encoder(which, scene)) is not None
    }
    parts = FieldParts(encoders, hooks.color_inputs)
    field = RadianceField(config, scene.box, hooks.layer, parts)
    # After the layers, whose initial weights must not depend on the random numbers drawn here.
    for name, trained in hooks.modules(scene, field.density_width).items():
        field.add_plugin(name, trained)
    return field

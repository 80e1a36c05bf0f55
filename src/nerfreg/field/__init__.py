"""The radiance field: hash grid, spherical harmonics and two small networks."""

from nerfreg.field.config import FieldConfig
from nerfreg.field.radiance_field import RadianceField

__all__ = ["FieldConfig", "RadianceField"]

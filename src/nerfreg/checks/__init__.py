"""Stiff and extreme cases, run against any plugin, and what its hooks may return."""

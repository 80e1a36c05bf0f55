"""Statistics, tables and figures that the tools share."""

"""From configuration files and overrides to typed, checked configurations."""

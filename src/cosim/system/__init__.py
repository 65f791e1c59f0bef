"""From a file (TOML, SSP) to a checked System, and back."""

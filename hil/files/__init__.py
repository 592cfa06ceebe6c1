"""Files of any kind: atomic writing, arrays by name, metadata as TOML text."""

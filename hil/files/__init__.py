"""Files of any kind: whole or not there, arrays by name, metadata as TOML text."""

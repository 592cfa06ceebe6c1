"""The witness is a benchmark's."""

from __future__ import annotations

import sys

from places import BENCHMARKS

sys.path.insert(0, str(BENCHMARKS))

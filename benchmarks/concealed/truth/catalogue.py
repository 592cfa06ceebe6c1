"""Every kind of hidden physics, by name."""

from __future__ import annotations

from concealed.truth import drive_kinds, effort_kinds, friction_kinds, sensor_kinds
from concealed.truth.kinds import Kind

INSIDE: dict[str, Kind] = {
    kind.name: kind for kinds in (friction_kinds.KINDS, effort_kinds.KINDS, drive_kinds.KINDS, sensor_kinds.KINDS) for kind in kinds
}
"""Physics that the catalogue names, in other equations."""

OUTSIDE: dict[str, Kind] = {
    kind.name: kind for kinds in (friction_kinds.OUTSIDE, effort_kinds.OUTSIDE, drive_kinds.OUTSIDE) for kind in kinds
}
"""Physics that no catalogue effect spans."""

KINDS = INSIDE | OUTSIDE

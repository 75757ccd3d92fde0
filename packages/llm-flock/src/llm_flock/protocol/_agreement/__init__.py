"""Agreement on a plan and on distinct slots in it: the subject of the paper."""

from __future__ import annotations

from collections.abc import Mapping

PRESET_RULES: Mapping[str, tuple[str, str, bool]] = {
    "flock": ("provenance", "auction", True),
    "paper": ("influence", "nearest-free", False),
    "paper-literal": ("influence", "nearest", False),
    "released": ("leader", "shared-table", False),
    "baseline": ("none", "index", False),
}
"""The protocols by name: rules of consensus and of assignment, and whether the shield is on."""

"""What a run is measured by."""

from llm_flock.metrics.shape_error import ShapeError, ShapeTarget, procrustes

__all__ = ["ShapeError", "ShapeTarget", "procrustes"]

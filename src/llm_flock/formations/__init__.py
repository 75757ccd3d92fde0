"""Named shapes and their ideal target points, points from a file, and the geometry of a set of points."""

from llm_flock.formations.geometry import circumradius, distances, rotated, rotational_symmetry, smallest_distance
from llm_flock.formations.shapes import ShapeInfo, describe, ideal_points, shape_name, shapes

__all__ = [
    "ShapeInfo",
    "circumradius",
    "describe",
    "distances",
    "ideal_points",
    "rotated",
    "rotational_symmetry",
    "shape_name",
    "shapes",
    "smallest_distance",
]

"""Letters and digits with 30 robots, read by code that shares nothing with their placement: `letters36`.

python -m benchmarks letters36 [--robots N]
"""

from __future__ import annotations
import sys
import numpy as np

NAMES = "ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789"


def outline(letter, font):
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextPath

    path = TextPath((0, 0), letter, size=100, prop=FontProperties(family=font))
    rows = []
    for poly in path.to_polygons(closed_only=True):
        step = np.linalg.norm(np.diff(poly, axis=0), axis=1)
        at = np.concatenate([[0], np.cumsum(step)])
        s = np.arange(0, at[-1], 0.5)
        rows.append(np.column_stack([np.interp(s, at, poly[:, 0]), np.interp(s, at, poly[:, 1])]))
    return np.concatenate(rows)


def framed(p):
    low, high = p.min(0), p.max(0)
    return (p - (low + high) / 2) / (high[1] - low[1])


def chamfer(a, b):
    d = np.linalg.norm(a[:, None] - b[None], axis=2)
    return d.min(1).mean() + d.min(0).mean()


ALIKE = {"0": "O", "1": "I"}


def main(args=()):
    from llm_flock.formation import parse_program, program_points

    for font in ("DejaVu Sans", "DejaVu Sans Mono", "DejaVu Serif", "cmss10", "STIXGeneral"):
        glyphs = {l: framed(outline(l, font)) for l in NAMES}
        good = 0
        bad = []
        for l in NAMES:
            p = framed(program_points(parse_program({"draw": [{"text": l}]}), 30, 2, 1.0))
            d = {g: chamfer(p, glyphs[g]) for g in NAMES}
            best = min(d, key=d.get)
            ok = ALIKE.get(best, best) == ALIKE.get(l, l)
            good += ok
            if not ok:
                bad.append((l, best, round(d[l], 3), round(d[best], 3)))
        print(font, good, bad)


if __name__ == "__main__":
    main()

"""A state machine as SVG."""

from __future__ import annotations

import html
import math
from collections import defaultdict

WIDTH, HEIGHT = 760, 520
BOX_W, BOX_H = 124, 38


def draw(edges: list[tuple[str, str, list[str]]]) -> str:
    """The machine as SVG: the cycle of phases on a ring, a phase without a way out in the middle."""
    labels: dict[tuple[str, str], list[str]] = defaultdict(list)
    for source, event, targets in edges:
        for target in targets:
            labels[source, target].append(event)
    sources = list(dict.fromkeys(source for source, _, _ in edges))
    ends = sorted({target for _, target in labels} - set(sources))
    center = (WIDTH / 2, HEIGHT / 2)
    place = {
        name: (
            center[0] + 285 * math.sin(2 * math.pi * i / len(sources)),
            center[1] - 205 * math.cos(2 * math.pi * i / len(sources)),
        )
        for i, name in enumerate(sources)
    }
    place.update({name: (center[0], center[1] + 60.0 * i) for i, name in enumerate(ends)})
    parts = [arrow(place[a], place[b], events, faint=b in ends) for (a, b), events in labels.items() if a != b]
    parts += [loop(place[a], center, events) for (a, b), events in labels.items() if a == b]
    parts += [box(name, at) for name, at in place.items()]
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="State diagram of the agent" '
        'style="max-width:100%;height:auto;font:14px sans-serif" xmlns="http://www.w3.org/2000/svg">'
        '<defs><marker id="tip" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="8" markerHeight="8" orient="auto">'
        '<path d="M0 0L10 5L0 10z" fill="currentColor"/></marker></defs>' + "".join(parts) + "</svg>"
    )


def box(name: str, at: tuple[float, float]) -> str:
    """One phase."""
    x, y = at
    return (
        f'<rect x="{x - BOX_W / 2:.0f}" y="{y - BOX_H / 2:.0f}" width="{BOX_W}" height="{BOX_H}" rx="8" '
        'fill="var(--color-background-secondary, #eee)" stroke="currentColor"/>'
        f'<text x="{x:.0f}" y="{y + 5:.0f}" text-anchor="middle" fill="currentColor">{html.escape(name)}</text>'
    )


def arrow(a: tuple[float, float], b: tuple[float, float], events: list[str], *, faint: bool) -> str:
    """A transition between two phases, from border to border, its events past the middle, clear of the box there."""
    (ax, ay), (bx, by) = border(a, b), border(b, a)
    style = 'opacity="0.35" stroke-dasharray="4 4"' if faint else ""
    line = (
        f'<line x1="{ax:.0f}" y1="{ay:.0f}" x2="{bx:.0f}" y2="{by:.0f}" stroke="currentColor" '
        f'marker-end="url(#tip)" {style}/>'
    )
    return line if faint else line + caption(ax + 0.62 * (bx - ax), ay + 0.62 * (by - ay), events)


def loop(at: tuple[float, float], center: tuple[float, float], events: list[str]) -> str:
    """Events that leave the phase as it is, on the side away from the middle."""
    x, y = at
    side = 1 if y >= center[1] else -1
    edge = y + side * BOX_H / 2
    path = (
        f'<path d="M{x - 25:.0f} {edge:.0f} c-10 {side * 30}, 60 {side * 30}, 50 0" fill="none" '
        'stroke="currentColor" marker-end="url(#tip)"/>'
    )
    return path + caption(x, edge + side * 32, events, " · ")


def caption(x: float, y: float, events: list[str], joint: str = ", ") -> str:
    """Names of events, on a backing that keeps lines out of the letters."""
    text = html.escape(joint.join(events))
    return (
        f'<text x="{x:.0f}" y="{y + 4:.0f}" text-anchor="middle" font-size="12" fill="currentColor" '
        f'stroke="var(--color-background-primary, #fff)" stroke-width="5" paint-order="stroke">{text}</text>'
    )


def border(a: tuple[float, float], b: tuple[float, float]) -> tuple[float, float]:
    """Where the line from the middle of box a to b leaves the box."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    reach = min(BOX_W / 2 / abs(dx) if dx else math.inf, BOX_H / 2 / abs(dy) if dy else math.inf)
    return a[0] + dx * reach, a[1] + dy * reach

"""SVG path data as polylines: every command of the standard, curves in short straight pieces."""

from __future__ import annotations

import cmath
import math
import re
from collections.abc import Callable, Iterator

from llm_flock.errors import InputError

Stroke = list[complex]
"""Corners of a polyline, x + iy, y downwards; the first again at the end if it is closed."""

_TOKEN = re.compile(r"([a-df-zA-DF-Z])|([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,3})?)|[\s,]+|(.)", re.DOTALL)
_TAKES = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "T": 2, "A": 7, "Z": 0}
PIECES = 12  #: Straight pieces of a curve, and of a quarter of an ellipse.


def strokes_of(data: str, field: str = "path") -> list[Stroke]:
    """The subpaths of SVG path data, one stroke each; a subpath of one point is a stroke of one corner.

    Raises:
        InputError: the data is not of SVG's form; names `field` and the place in it.
    """
    strokes: list[Stroke] = []
    here = start = 0j
    last, control = "", 0j  # the command before, and its last control point
    for command, numbers in _commands(data, field):
        kind, origin = command.upper(), here if command.islower() else 0j
        p = [origin + complex(x, y) for x, y in zip(numbers[::2], numbers[1::2], strict=False)]
        if kind not in "MZ" and (not strokes or last in ("", "Z")):
            strokes.append([here])
        smooth = 2 * here - control
        match kind:
            case "M":
                here = start = p[0]
                strokes.append([here])
            case "Z":
                if strokes and len(strokes[-1]) > 1 and strokes[-1][-1] != start:
                    strokes[-1].append(start)
                here = start
            case "L":
                strokes[-1].append(p[0])
            case "H":
                strokes[-1].append(complex(origin.real + numbers[0], here.imag))
            case "V":
                strokes[-1].append(complex(here.real, origin.imag + numbers[0]))
            case "C" | "S":
                a, b, end = p if kind == "C" else (smooth if last in ("C", "S") else here, *p)
                control = b
                strokes[-1] += _bezier(here, a, b, end)
            case "Q" | "T":
                a, end = p if kind == "Q" else (smooth if last in ("Q", "T") else here, p[0])
                control = a
                strokes[-1] += _bezier(here, here + 2 / 3 * (a - here), end + 2 / 3 * (a - end), end)
            case _:
                rx, ry, turn, large, sweep, *_ = numbers
                end = origin + complex(*numbers[5:])
                strokes[-1] += _arc(here, end, abs(rx), abs(ry), math.radians(turn), large != 0, sweep != 0)
        if kind not in "MZ":
            here = strokes[-1][-1]
        last = kind
    return strokes


def _commands(data: str, field: str) -> Iterator[tuple[str, list[float]]]:
    command, numbers, place = "", list[float](), 0
    while place < len(data):
        # The two flags of an arc may stand together with what follows them.
        flag = command in ("a", "A") and len(numbers) in (3, 4) and data[place] in "01"
        match = _TOKEN.match(data, place)
        assert match is not None, "a token is at least one letter"
        if match[3] or (match[1] and (match[1].upper() not in _TAKES or numbers)):
            raise _refused(field, data, place)
        place = place + 1 if flag else match.end()
        if match[1]:
            command = str(match[1])
            if command in "zZ":
                yield command, []
        elif flag or match[2]:
            if not command or command in "zZ":
                raise _refused(field, data, match.start())
            if len(numbers) in (3, 4) and command in ("a", "A") and not flag:
                raise _refused(field, data, match.start())
            numbers.append(float(match[0][0] if flag else match[2]))
            if len(numbers) == _TAKES[command.upper()]:
                if not all(abs(x) < 1e9 for x in numbers):
                    raise _refused(field, data, match.start())
                yield command, numbers
                numbers, command = [], {"m": "l", "M": "L"}.get(command, command)
    if numbers or (command and data.rstrip()[-1] == command and command not in "zZ"):
        raise _refused(field, data, len(data))


def _refused(field: str, data: str, place: int) -> InputError:
    there = f"{data[max(0, place - 12) : place]!r}" if place else "its beginning"
    return InputError(field, data, f"SVG path data such as 'M0 0L4 0L2 3Z'; it cannot be read on after {there}")


def _sampled(curve: Callable[[float], complex], pieces: int, end: complex) -> Stroke:
    return [*(curve(k / pieces) for k in range(1, pieces)), end]


def _bezier(start: complex, a: complex, b: complex, end: complex) -> Stroke:
    def curve(t: float) -> complex:
        s = 1 - t
        return s**3 * start + 3 * s * s * t * a + 3 * s * t * t * b + t**3 * end

    return _sampled(curve, PIECES, end)


def _arc(start: complex, end: complex, rx: float, ry: float, turn: float, large: bool, sweep: bool) -> Stroke:
    """An elliptical arc, by its centre (SVG 1.1, appendix F.6.5)."""
    if start == end:
        return []
    if not (rx and ry):
        return [end]
    tilt = cmath.rect(1.0, turn)

    def squeezed(z: complex) -> complex:
        """Coordinates in which the ellipse is the unit circle."""
        z /= tilt
        return complex(z.real / rx, z.imag / ry)

    p, q = squeezed(start), squeezed(end)
    half = abs(q - p) / 2
    middle, across = (p + q) / 2, (q - p) / abs(q - p)
    if half > 1:  # too small radii grow
        rx, ry, p, q, middle, half = rx * half, ry * half, p / half, q / half, middle / half, 1.0
    center = middle + across * 1j * math.sqrt(1 - half * half) * (1 if large != sweep else -1)
    first, last = cmath.phase(p - center), cmath.phase(q - center)
    swept = (last - first) % math.tau if sweep else -((first - last) % math.tau)
    pieces = max(2, math.ceil(4 * PIECES * abs(swept) / math.tau - 1e-9))

    def curve(t: float) -> complex:
        z = center + cmath.rect(1.0, first + t * swept)
        return complex(z.real * rx, z.imag * ry) * tilt

    return _sampled(curve, pieces, end)

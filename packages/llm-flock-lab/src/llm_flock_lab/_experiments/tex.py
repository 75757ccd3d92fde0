"""Plain text and tables for LaTeX."""

from __future__ import annotations

import re
from collections.abc import Sequence

TEX = {sign: f"\\{sign}" for sign in "{}$&#%_"} | {
    "\\": "\\textbackslash{}", "^": "\\textasciicircum{}", "~": "\\textasciitilde{}", '"': "\\textquotedbl{}",
    "<": "\\textless{}", ">": "\\textgreater{}", "|": "\\textbar{}", "[": "{[}", "]": "{]}",
    "\N{MIDDLE DOT}": "$\\cdot$", "\N{MINUS SIGN}": "$-$", "\N{SUPERSCRIPT TWO}": "$^2$",
}  # fmt: skip
"""Letters that LaTeX reads as something else, or lacks."""


def to_tex(text: object) -> str:
    """Plain text for LaTeX: special signs are escaped, what a plain LaTeX lacks is a question mark, names may break."""
    plain = "".join(TEX.get(sign, sign if ord(sign) < 0x100 else "?") for sign in " ".join(str(text).split()))
    return re.sub(r"(?<=[,:@/])(?=\S)", r"\\allowbreak{}", plain)


def tex_table(header: Sequence[str], rows: Sequence[Sequence[str]], words: int) -> str:
    """A table of texts, whose first `words` columns are left-aligned; it needs the package booktabs."""
    lines = [" & ".join(map(to_tex, line)) + r" \\" for line in (header, *rows)]
    kinds = f"@{{}}{'l' * words}{'r' * (len(header) - words)}@{{}}"  # as wide as its rules
    parts = (rf"\begin{{tabular}}{{{kinds}}}", r"\toprule", lines[0], r"\midrule", *lines[1:], r"\bottomrule")
    return "\n".join((*parts, r"\end{tabular}"))

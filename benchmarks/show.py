"""Sixty robots fly a word, a heart and a sphere, from one sentence each: `make show`.

    python -m benchmarks.show [--out runs/show/show.gif]

Every robot's model reads the sentence in force and answers with a formation program; the team agrees on one, assigns
the places and flies. The reader is *simulated*, as the animation says: its three programs are written below. Everything
else is what `llm-flock run` does.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks import words
from matplotlib import font_manager
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

import llm_flock
from llm_flock.arrays import Points
from llm_flock.llm._port import Call

ROBOTS = 60
HEART = "M0 30C-50 -5 -30 -45 0 -20C30 -45 50 -5 0 30Z"
SENTENCES: dict[str, dict[str, Any]] = {
    "Spell FLOCK across the sky.": {"draw": [{"text": "FLOCK", "tilt": 90}]},
    "Now fly a heart.": {"draw": [{"union": [{"path": HEART, "tilt": 90}], "turn": 70}]},
    "Close up to a sphere.": {"draw": [{"shape": "sphere"}], "size": 66},
}
ORDERS = (0, 26, 49)  # rounds in which one robot is told each sentence
COLOURS = np.array([(90, 200, 255), (255, 80, 130), (255, 200, 90)], dtype=np.float64)  # of each sentence's team
TURNS_DEG = ((-38, 0, 8), (8, 70, 78), (78, 110, 190))  # of the camera: at the order, when formed, at the end
SIZE = (720, 440)
FPS, STEPS, HOLD = 12, 3, 12  # frames a second, a round, and of the formed team
SKY, DEEP = np.array((16.0, 22.0, 44.0)), np.array((5.0, 6.0, 14.0))
FADE = 0.8  # of trails, a frame


class Reader(words.Reader):
    """A *simulated* model that answers each sentence with a program; its steps are good."""

    def __init__(self) -> None:
        super().__init__("", 0)

    async def ask(self, call: Call) -> Any:
        said = next(sentence for sentence in SENTENCES if sentence in call.messages[0].text)
        self._program = json.dumps(SENTENCES[said])
        return await super().ask(call)


def fly() -> tuple[NDArray[np.float64], list[int]]:
    """Positions, shape (rounds + 1, n, 3) [units], and the rounds in which each formation had formed."""
    first, *others = SENTENCES
    mission = llm_flock.Mission(
        shape=f"text:{first}",
        n_robots=ROBOTS,
        center=(100.0, 100.0, 72.0),
        arena=((0.0,) * 3, (200.0, 200.0, 140.0)),
        spacing=6.0,
        comm_range=45.0,
    )
    given = zip(ORDERS[1:], others, strict=True)
    flown = llm_flock.run(
        mission,
        changes=[{"round": when, "robot": 0, "set": {"shape": f"text:{sentence}"}} for when, sentence in given],
        prompts="program",
        decide="on-event",
        model=Reader(),
        seed=4,
    )
    return flown.positions, [one.formed or ORDERS[k] for k, one in enumerate(flown.summary.missions)]


def camera(turn_deg: float) -> tuple[Points, Points]:
    """The axes of the picture, shape (3, 3): right, up and away; and where the camera looks, shape (3,)."""
    turn, tilt = math.radians(turn_deg), math.radians(8.0)
    right = np.array([math.cos(turn), math.sin(turn), 0.0])
    away = np.array([-math.sin(turn) * math.cos(tilt), math.cos(turn) * math.cos(tilt), -math.sin(tilt)])
    return np.array([right, np.cross(right, away), away]), np.array([100.0, 100.0, 66.0])


def projected(points: Points, turn_deg: float) -> Points:
    """Columns of the picture: x, y [pixels], and scale [pixels per unit], shape (n, 3)."""
    axes, middle = camera(turn_deg)
    seen = (points - middle) @ axes.T
    scale = SIZE[0] * 1.06 / (250.0 + seen[:, 2])
    return np.column_stack([SIZE[0] / 2 + scale * seen[:, 0], SIZE[1] * 0.43 - scale * seen[:, 1], scale])


def glow(onto: NDArray[np.float64], dots: Points, colour: NDArray[np.float64], radius: float, power: float) -> None:
    """Add soft discs to a picture, shape (height, width, 3)."""
    nearness = (dots[:, 2] / dots[:, 2].mean()) ** 3  # what is far away is dim
    for (x, y, scale), near in zip(dots.tolist(), nearness.tolist(), strict=True):
        reach = math.ceil(4 * radius * scale)
        left, top = max(0, int(x) - reach), max(0, int(y) - reach)
        piece = onto[top : max(top, int(y) + reach + 1), left : max(left, int(x) + reach + 1)]
        if piece.size:
            rows, columns = np.ogrid[top : top + piece.shape[0], left : left + piece.shape[1]]
            away = ((columns - x) ** 2 + (rows - y) ** 2) / (radius * scale) ** 2
            piece += power * near * np.exp(-away / 2)[:, :, None] * colour


def background(turn_deg: float) -> NDArray[np.float64]:
    """The sky, and a grid on the ground."""
    share = np.linspace(0.0, 1.0, SIZE[1])[:, None, None]
    sky = np.broadcast_to(DEEP + share * (SKY - DEEP), (SIZE[1], SIZE[0], 3))
    image = Image.fromarray(sky.astype(np.uint8))
    pen = ImageDraw.Draw(image)
    for at in range(0, 201, 20):
        for ends in (((at, 0.0, 0.0), (at, 200.0, 0.0)), ((0.0, at, 0.0), (200.0, at, 0.0))):
            (x, y, _), (u, v, _) = projected(np.array(ends, dtype=np.float64), turn_deg).tolist()
            pen.line((x, y, u, v), fill=(30, 40, 70))
    return np.asarray(image, dtype=np.float64)


def pictures(positions: NDArray[np.float64], formed: Sequence[int]) -> Iterator[Image.Image]:
    """The frames: robots fly straight between rounds, and each formation is held for a while."""
    path = Path(font_manager.findfont("DejaVu Sans"))
    large, small = (ImageFont.truetype(path, size) for size in (22, 12))
    starts = [*ORDERS, len(positions) - 1]
    trail = np.zeros((SIZE[1], SIZE[0], 3))
    for k, sentence in enumerate(SENTENCES):
        begin, there = starts[k], formed[k]
        moments = [begin + step / STEPS for step in range(STEPS * (there - begin))]
        moments += [float(there)] * (HOLD if k < 2 else 4 * HOLD)
        flying = STEPS * (there - begin)
        before, at, after = TURNS_DEG[k]
        for step, moment in enumerate(moments):
            way, rest = min(1.0, step / flying), max(0.0, (step - flying) / (len(moments) - flying))
            ease = way * way * (3 - 2 * way)
            turn = before + (at - before) * ease + (after - at) * rest
            whole = min(int(moment), len(positions) - 2)
            here = positions[whole] + (moment - whole) * (positions[whole + 1] - positions[whole])
            old = COLOURS[max(0, k - 1)]
            colour = old + min(1.0, 2 * way) * (COLOURS[k] - old)
            dots = projected(here, turn)
            canvas = background(turn)
            floor = projected(here * np.array([1.0, 1.0, 0.0]), turn)
            glow(canvas, floor, 0.25 * colour, 1.4, 0.35)
            glow(canvas, dots, colour, 2.6, 0.30)
            trail *= FADE
            glow(trail, dots, colour, 0.8, 0.22)
            canvas += trail
            glow(canvas, dots, np.array([255.0, 255.0, 255.0]), 0.75, 1.0)
            image = Image.fromarray(canvas.clip(0, 255).astype(np.uint8))
            pen = ImageDraw.Draw(image)
            typed = sentence[: 2 + int(1.2 * step)]
            pen.text((SIZE[0] / 2, SIZE[1] - 44), f"“{typed}”", font=large, fill=(240, 243, 250), anchor="mm")
            done = "formed" if moment >= there else f"round {math.ceil(moment) - begin}"
            note = f"{ROBOTS} robots, each with a model of its own, no leader · {done} · simulated reader"
            pen.text((SIZE[0] / 2, SIZE[1] - 16), note, font=small, fill=(140, 152, 180), anchor="mm")
            yield image


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("runs/show/show.gif"))
    given = parser.parse_args(arguments)
    positions, formed = fly()
    print(f"formed in rounds {formed} after orders in rounds {list(ORDERS)}; simulated reader", flush=True)
    shown = list(pictures(positions, formed))
    given.out.parent.mkdir(parents=True, exist_ok=True)
    sample = Image.new("RGB", (SIZE[0], 6 * SIZE[1]))
    for k in range(6):
        sample.paste(shown[(2 * k + 1) * len(shown) // 12], (0, k * SIZE[1]))
    palette = sample.quantize(256)
    frames = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in shown]
    frames[0].save(given.out, save_all=True, append_images=frames[1:], duration=round(1000 / FPS), loop=0)
    print(f"{given.out}: {len(frames)} frames, {given.out.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()

// Rounds from left to right: marks of what happened, the cursor, and what is not flown yet.
import { FONT, Paper, theme } from "llm-flock-viewer/paper.js";

const LEFT = 64;
const RIGHT = 14;
const AXIS = 20;

export class Timeline {
  constructor(element, reels, clock, options, emit) {
    this.reels = reels;
    this.clock = clock;
    this.lanes = options.lanes;
    this.emit = emit;
    this.paper = new Paper(element, "Time line: rounds and what happened in them. Left and right arrows step.");
    this.paper.canvas.setAttribute("role", "slider");
    this.paper.redraw = () => this.draw();
    this.forget = clock.listen(() => this.draw());
    this.told = null;
    const canvas = this.paper.canvas;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.dragging = true;
      this.jump(event, true);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (this.dragging) this.jump(event, false);
      else this.hover(event);
    });
    for (const name of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(name, () => { this.dragging = false; });
    }
    this.keys = (event) => this.key(event);
    document.addEventListener("keydown", this.keys);
    this.paper.fit();
  }

  /** Keys of the whole page, but where somebody types or works another control. */
  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || event.shiftKey) return;
    if (event.target.closest("input, textarea, select, [role=tab], [role=listbox], [contenteditable]")) return;
    if (event.key === " " && event.target.closest("button, a, [role=checkbox], [role=button]")) return;
    const { clock } = this;
    const acts = {
      " ": () => clock.toggle(), ArrowLeft: () => clock.step(-1), ArrowRight: () => clock.step(1),
      Home: () => clock.seek(0), End: () => clock.live(),
    };
    if (!acts[event.key]) return;
    acts[event.key]();
    event.preventDefault();
  }

  get span() {
    return Math.max(1, this.clock.last);
  }

  x(round) {
    return LEFT + (round / this.span) * (this.paper.width - LEFT - RIGHT);
  }

  round(x) {
    const share = (x - LEFT) / Math.max(1, this.paper.width - LEFT - RIGHT);
    return Math.round(Math.max(0, Math.min(1, share)) * this.span);
  }

  lane(y) {
    const rows = this.lanes.length;
    const k = Math.floor((y / (this.paper.height - AXIS)) * rows);
    return this.lanes[k] ? this.lanes[k].name : null;
  }

  /** The round of the nearest mark of a lane within a finger's width, or the round itself. */
  near(x, y) {
    const lane = this.lane(y);
    const round = this.round(x);
    if (!lane) return round;
    let best = round;
    let nearest = 10;
    for (const reel of this.reels) {
      for (const [number, counts] of reel.marks) {
        const far = Math.abs(this.x(number) - x);
        if (counts[lane] && far < nearest) [best, nearest] = [number, far];
      }
    }
    return best;
  }

  jump(event, snap) {
    this.clock.playing = false;
    this.clock.seek(snap ? this.near(event.offsetX, event.offsetY) : this.round(event.offsetX));
  }

  hover(event) {
    const lane = this.lanes.find((one) => one.name === this.lane(event.offsetY));
    this.paper.canvas.title = lane ? `${lane.name}: ${lane.about}` : "";
  }

  draw() {
    const { pen, width, height } = this.paper;
    if (!width) return;
    const colours = theme();
    this.paper.clear();
    const rows = this.lanes.length;
    const row = (height - AXIS) / rows;
    pen.font = `11px ${FONT}`;
    pen.textBaseline = "middle";
    this.lanes.forEach((lane, k) => {
      const y = (k + 0.5) * row;
      pen.fillStyle = colours.soft;
      pen.textAlign = "left";
      pen.fillText(lane.name, 4, y);
      pen.strokeStyle = colours.grid;
      pen.lineWidth = 1;
      pen.beginPath();
      pen.moveTo(LEFT, y);
      pen.lineTo(width - RIGHT, y);
      pen.stroke();
      this.marks(lane, y, Math.min(5, row / 2 - 1));
    });
    this.axis(height - AXIS);
    const x = this.x(Math.min(this.clock.cursor, this.span));
    pen.strokeStyle = colours.accent;
    pen.lineWidth = 2;
    pen.beginPath();
    pen.moveTo(x, 0);
    pen.lineTo(x, height - AXIS + 4);
    pen.stroke();
    const canvas = this.paper.canvas;
    canvas.setAttribute("aria-valuemin", "0");
    canvas.setAttribute("aria-valuemax", String(this.clock.last));
    canvas.setAttribute("aria-valuenow", String(this.clock.round));
    this.tell();
  }

  /** The server is told where the cursor is, for the words beside it; not more often than they can be read. */
  tell() {
    const { clock } = this;
    const now = {
      round: clock.round, last: clock.last, playing: clock.playing, following: clock.following,
      open: this.reels.some((reel) => reel.open), failure: this.reels.map((reel) => reel.failure).find(Boolean) || "",
    };
    const text = JSON.stringify(now);
    if (text === this.told || this.waiting) return;
    this.waiting = true;
    setTimeout(() => {
      this.waiting = false;
      const late = JSON.stringify({ ...now, round: clock.round, last: clock.last });
      if (late !== text) return this.tell();
      this.told = text;
      this.emit("cursor", now);
      // What is told before the page is connected is lost: told once more, if it still holds.
      setTimeout(() => { if (this.told === text) this.emit("cursor", now); }, 1000);
      return undefined;
    }, clock.playing || clock.following ? 0 : 60);
  }

  marks(lane, y, size) {
    const { pen } = this.paper;
    const colours = theme();
    pen.fillStyle = pen.strokeStyle = lane.name === "faults" ? colours.warn : colours.ink;
    pen.lineWidth = 1.5;
    let before = -Infinity;
    for (const reel of this.reels) {
      for (const [round, counts] of reel.marks) {
        if (!counts[lane.name]) continue;
        const x = this.x(round);
        if (Math.abs(x - before) < 1.5) continue;
        before = x;
        mark(pen, lane.mark, x, y, size);
      }
      before = -Infinity;
    }
  }

  axis(y) {
    const { pen, width } = this.paper;
    const room = Math.max(1, Math.floor((width - LEFT - RIGHT) / 60));
    const rough = this.span / room;
    const power = 10 ** Math.floor(Math.log10(Math.max(1, rough)));
    const by = Math.max(1, power * ([1, 2, 5, 10].find((k) => k * power >= rough) || 10));
    pen.fillStyle = theme().soft;
    pen.textAlign = "left";
    pen.fillText("round", 4, y + 12);
    pen.textAlign = "center";
    for (let round = 0; round <= this.span; round += by) pen.fillText(String(round), this.x(round), y + 12);
  }

  close() {
    document.removeEventListener("keydown", this.keys);
    this.forget();
    this.paper.close();
  }
}

function mark(pen, shape, x, y, r) {
  const paths = {
    diamond: [[0, -1], [1, 0], [0, 1], [-1, 0]],
    triangle: [[0, -1], [1, 0.9], [-1, 0.9]],
    square: [[-0.85, -0.85], [0.85, -0.85], [0.85, 0.85], [-0.85, 0.85]],
    bolt: [[0.3, -1.2], [-0.8, 0.2], [0, 0.2], [-0.3, 1.2], [0.8, -0.2], [0, -0.2]],
    flag: [[-0.7, -1.1], [0.9, -0.5], [-0.4, 0.1], [-0.4, 1.1], [-0.7, 1.1]],
  };
  pen.beginPath();
  if (shape === "circle") {
    pen.arc(x, y, r * 0.8, 0, 2 * Math.PI);
    pen.fill();
  } else if (shape === "cross") {
    pen.moveTo(x - r * 0.8, y - r * 0.8);
    pen.lineTo(x + r * 0.8, y + r * 0.8);
    pen.moveTo(x + r * 0.8, y - r * 0.8);
    pen.lineTo(x - r * 0.8, y + r * 0.8);
    pen.stroke();
  } else {
    paths[shape].forEach(([a, b], k) => pen[k ? "lineTo" : "moveTo"](x + a * r, y + b * r));
    pen.closePath();
    pen.fill();
  }
}

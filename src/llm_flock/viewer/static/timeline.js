// Rounds from left to right, with marks for events, and the cursor.
import { FONT, Surface, theme } from "llm-flock-viewer/surface.js";

const LEFT = 64;
const RIGHT = 14;
const AXIS = 20;

export class Timeline {
  constructor(element, runs, clock, options, emit) {
    this.runs = runs;
    this.clock = clock;
    this.tracks = options.tracks;
    this.emit = emit;
    const label = "Time line: rounds and what happened in them. Left and right arrows step.";
    this.surface = new Surface(element, label, () => this.draw());
    this.surface.canvas.setAttribute("role", "slider");
    this.forget = clock.listen(() => this.draw());
    this.sent = null;
    this.surface.drag((event) => this.jump(event, true), (event) => this.jump(event, false), (event) => this.hover(event));
    this.keys = (event) => this.key(event);
    document.addEventListener("keydown", this.keys);
    this.surface.fit();
  }

  /** Keys of the whole page, except where another control has the focus. */
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
    return LEFT + (round / this.span) * (this.surface.width - LEFT - RIGHT);
  }

  round(x) {
    const share = (x - LEFT) / Math.max(1, this.surface.width - LEFT - RIGHT);
    return Math.round(Math.max(0, Math.min(1, share)) * this.span);
  }

  track(y) {
    const rows = this.tracks.length;
    const k = Math.floor((y / (this.surface.height - AXIS)) * rows);
    return this.tracks[k] ? this.tracks[k].name : null;
  }

  /** The round of the nearest mark of a track within a finger's width, or the round itself. */
  near(x, y) {
    const track = this.track(y);
    const round = this.round(x);
    if (!track) return round;
    let best = round;
    let nearest = 10;
    for (const run of this.runs) {
      for (const [number, counts] of run.marks) {
        const far = Math.abs(this.x(number) - x);
        if (counts[track] && far < nearest) [best, nearest] = [number, far];
      }
    }
    return best;
  }

  jump(event, snap) {
    this.clock.playing = false;
    this.clock.seek(snap ? this.near(event.offsetX, event.offsetY) : this.round(event.offsetX));
  }

  hover(event) {
    const track = this.tracks.find((one) => one.name === this.track(event.offsetY));
    this.surface.canvas.title = track ? `${track.name}: ${track.about}` : "";
  }

  draw() {
    const { pen, width, height } = this.surface;
    if (!width) return;
    const colours = theme();
    this.surface.clear();
    const rows = this.tracks.length;
    const row = (height - AXIS) / rows;
    pen.font = `11px ${FONT}`;
    pen.textBaseline = "middle";
    this.tracks.forEach((track, k) => {
      const y = (k + 0.5) * row;
      pen.fillStyle = colours.soft;
      pen.textAlign = "left";
      pen.fillText(track.name, 4, y);
      pen.strokeStyle = colours.grid;
      pen.lineWidth = 1;
      this.surface.line([LEFT, y], [width - RIGHT, y]);
      this.marks(track, y, Math.min(5, row / 2 - 1));
    });
    this.axis(height - AXIS);
    const x = this.x(Math.min(this.clock.cursor, this.span));
    pen.strokeStyle = colours.accent;
    pen.lineWidth = 2;
    this.surface.line([x, 0], [x, height - AXIS + 4]);
    const canvas = this.surface.canvas;
    canvas.setAttribute("aria-valuemin", "0");
    canvas.setAttribute("aria-valuemax", String(this.clock.last));
    canvas.setAttribute("aria-valuenow", String(this.clock.round));
    this.send();
  }

  /** Send the cursor to the server, which renders the text beside it; no more often than text can be read. */
  send() {
    const { clock } = this;
    const now = {
      round: clock.round, last: clock.last, playing: clock.playing, following: clock.following,
      open: this.runs.some((run) => run.open), failure: this.runs.map((run) => run.failure).find(Boolean) || "",
    };
    const text = JSON.stringify(now);
    if (text === this.sent || this.waiting) return;
    this.waiting = true;
    setTimeout(() => {
      this.waiting = false;
      const late = JSON.stringify({ ...now, round: clock.round, last: clock.last });
      if (late !== text) return this.send();
      this.sent = text;
      this.emit("cursor", now);
      // A message from before the page is connected is lost: send it once more, if it still holds.
      setTimeout(() => { if (this.sent === text) this.emit("cursor", now); }, 1000);
      return undefined;
    }, clock.playing || clock.following ? 0 : 60);
  }

  marks(track, y, size) {
    const { pen } = this.surface;
    const colours = theme();
    pen.fillStyle = pen.strokeStyle = track.name === "faults" ? colours.warn : colours.ink;
    pen.lineWidth = 1.5;
    let before = -Infinity;
    for (const run of this.runs) {
      for (const [round, counts] of run.marks) {
        if (!counts[track.name]) continue;
        const x = this.x(round);
        if (Math.abs(x - before) < 1.5) continue;
        before = x;
        mark(this.surface, track.mark, x, y, size);
      }
      before = -Infinity;
    }
  }

  axis(y) {
    const { pen, width } = this.surface;
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
    this.surface.close();
  }
}

function mark(surface, shape, x, y, r) {
  const paths = {
    diamond: [[0, -1], [1, 0], [0, 1], [-1, 0]],
    triangle: [[0, -1], [1, 0.9], [-1, 0.9]],
    square: [[-0.85, -0.85], [0.85, -0.85], [0.85, 0.85], [-0.85, 0.85]],
    bolt: [[0.3, -1.2], [-0.8, 0.2], [0, 0.2], [-0.3, 1.2], [0.8, -0.2], [0, -0.2]],
    flag: [[-0.7, -1.1], [0.9, -0.5], [-0.4, 0.1], [-0.4, 1.1], [-0.7, 1.1]],
  };
  if (shape === "cross") {
    surface.pen.beginPath();
    for (const side of [-0.8, 0.8]) {
      surface.pen.moveTo(x + side * r, y - 0.8 * r);
      surface.pen.lineTo(x - side * r, y + 0.8 * r);
    }
    surface.pen.stroke();
    return;
  }
  if (shape === "circle") surface.circle([x, y], r * 0.8);
  else surface.polygon(paths[shape].map(([a, b]) => [x + a * r, y + b * r]));
  surface.pen.fill();
}

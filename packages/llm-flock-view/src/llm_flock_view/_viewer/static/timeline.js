// Rounds from left to right, with marks for events, missions, when they were formed, and the cursor.
import { FONT, Surface, side, theme } from "llm-flock-viewer/surface.js";

const LEFT = 72;
const RIGHT = 14;
const AXIS = 20;

export class Timeline {
  constructor(element, runs, clock, options) {
    this.runs = runs;
    this.clock = clock;
    this.tracks = options.tracks;
    this.names = options.names;
    this.surface = new Surface(element, "Round", () => this.draw());
    this.surface.canvas.setAttribute("role", "slider");
    clock.listen(() => this.draw());
    this.surface.drag((event) => this.jump(event, true), (event) => this.jump(event, false), (event) => this.hover(event));
    this.surface.canvas.addEventListener("pointerleave", () => this.surface.tip(null));
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
    const k = Math.floor((y / (this.surface.height - AXIS)) * this.tracks.length);
    return this.tracks[k] || null;
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
        if (counts[track.name] && far < nearest) [best, nearest] = [number, far];
      }
    }
    return best;
  }

  jump(event, snap) {
    this.clock.playing = false;
    this.clock.seek(snap ? this.near(event.offsetX, event.offsetY) : this.round(event.offsetX));
  }

  hover(event) {
    const track = this.track(event.offsetY);
    this.surface.tip(track ? this.words(track, event.offsetX, event.offsetY) : null, event.offsetX, event.offsetY);
  }

  /** A track, or what happened in the round of the nearest mark, in words. */
  words(track, x, y) {
    if (x < LEFT - 6) return `${track.name}: ${track.about}`;
    const round = this.near(x, y);
    const counted = this.runs.map((run, k) => {
      const count = (run.marks.get(round) || {})[track.name];
      return count ? `${this.runs.length > 1 ? `${this.names[k]}: ` : ""}${count} × ${track.name}` : null;
    }).filter(Boolean);
    const missions = this.runs.flatMap((run) => run.missions.filter((one) => one.round === round && round > 0));
    const given = missions.length ? [`another mission: ${missions[0].text}`] : [];
    return [`Round ${round}`, ...counted, ...given].join(" · ") + (counted.length ? ` (${track.about[0].toLowerCase()}${track.about.slice(1)})` : "");
  }

  draw() {
    const { pen, width, height } = this.surface;
    if (!width) return;
    const colours = theme();
    this.surface.clear();
    const row = (height - AXIS) / this.tracks.length;
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
      this.runs.forEach((run, r) => this.marks(track, run, r, y, row));
    });
    this.axis(height - AXIS);
    const x = this.x(Math.min(this.clock.cursor, this.span));
    pen.strokeStyle = colours.accent;
    pen.lineWidth = 2;
    this.surface.line([x, 0], [x, height - AXIS + 4]);
    // Above the cursor, which would hide the tick of its round.
    this.runs.forEach((run, r) => this.missions(run, r, height - AXIS));
    const canvas = this.surface.canvas;
    canvas.setAttribute("aria-valuemin", "0");
    canvas.setAttribute("aria-valuemax", String(this.clock.last));
    canvas.setAttribute("aria-valuenow", String(this.clock.round));
  }

  /** Marks of one run; of two runs, the first has the upper half of each row and the second the lower. */
  marks(track, run, r, y, row) {
    const { pen } = this.surface;
    const colours = theme();
    const pair = this.runs.length > 1;
    const at = pair ? y + (r ? 0.24 : -0.24) * row : y;
    const size = pair ? Math.min(3.5, row / 4) : Math.min(5, row / 2 - 1);
    const bad = track.name === "faults" || track.mark === "pair";
    pen.fillStyle = pen.strokeStyle = pair ? side(r).ink : track.mark === "pair" ? colours.danger : bad ? colours.warn : colours.ink;
    pen.lineWidth = 1.5;
    if (pair) {
      // Whose half of the row this is, by the stroke of its side: colours alone do not tell it.
      this.surface.line([LEFT - 12, at], [LEFT - 3, at], side(r).stroke.length ? [3, 2] : []);
    }
    let before = -Infinity;
    for (const [round, counts] of run.marks) {
      if (!counts[track.name]) continue;
      const x = this.x(round);
      if (Math.abs(x - before) < 1.5) continue;
      before = x;
      mark(this.surface, track.mark, x, at, size);
    }
  }

  /** Where missions begin, where they are formed, and where a run ends before the other one. */
  missions(run, r, bottom) {
    const { pen } = this.surface;
    const pair = this.runs.length > 1;
    const parts = run.outcome ? run.outcome.missions : [];
    pen.font = `700 11px ${FONT}`;
    pen.fillStyle = pair ? side(r).ink : theme().good;
    for (const [first, last] of run.outcome ? run.outcome.stood : []) pen.fillRect(this.x(first), bottom - 5 - 6 * r, Math.max(2, this.x(last) - this.x(first)), 4);
    parts.forEach((part, k) => {
      if (k) {
        pen.strokeStyle = pair ? side(r).ink : theme().soft;
        pen.lineWidth = 1;
        this.surface.line([this.x(part.first), 0], [this.x(part.first), bottom], [2, 2]);
      }
      if (part.formed !== null) this.sign("✓", this.x(part.formed), bottom, pair ? side(r).ink : theme().good, r);
    });
    if (run.open || run.last >= this.clock.last) return;
    pen.strokeStyle = side(r).ink;
    pen.lineWidth = 2;
    this.surface.line([this.x(run.last), bottom - 6], [this.x(run.last), bottom + 4]);
  }

  sign(text, x, bottom, ink, r) {
    const { pen } = this.surface;
    pen.strokeStyle = ink;
    pen.lineWidth = 1.5;
    this.surface.line([x, 0], [x, bottom]);
    pen.fillStyle = theme().paper;
    pen.fillRect(x - 6, bottom - 13 - 13 * r, 12, 13);
    pen.fillStyle = ink;
    pen.textAlign = "center";
    pen.fillText(text, x, bottom - 6 - 13 * r);
  }

  axis(y) {
    const { pen, width } = this.surface;
    const room = Math.max(1, Math.floor((width - LEFT - RIGHT) / 60));
    const rough = this.span / room;
    const power = 10 ** Math.floor(Math.log10(Math.max(1, rough)));
    const by = Math.max(1, power * ([1, 2, 5, 10].find((k) => k * power >= rough) || 10));
    pen.font = `11px ${FONT}`;
    pen.fillStyle = theme().soft;
    pen.textAlign = "left";
    pen.fillText("round", 4, y + 12);
    pen.textAlign = "center";
    for (let round = 0; round <= this.span; round += by) pen.fillText(String(round), this.x(round), y + 12);
  }
}

const PATHS = {
  diamond: [[0, -1], [1, 0], [0, 1], [-1, 0]],
  triangle: [[0, -1], [1, 0.9], [-1, 0.9]],
  square: [[-0.85, -0.85], [0.85, -0.85], [0.85, 0.85], [-0.85, 0.85]],
  bolt: [[0.3, -1.2], [-0.8, 0.2], [0, 0.2], [-0.3, 1.2], [0.8, -0.2], [0, -0.2]],
  flag: [[-0.7, -1.1], [0.9, -0.5], [-0.4, 0.1], [-0.4, 1.1], [-0.7, 1.1]],
};

function mark(surface, shape, x, y, r) {
  if (shape === "cross") {
    surface.pen.beginPath();
    for (const way of [-0.8, 0.8]) {
      surface.pen.moveTo(x + way * r, y - 0.8 * r);
      surface.pen.lineTo(x - way * r, y + 0.8 * r);
    }
    surface.pen.stroke();
    return;
  }
  if (shape === "pair") {
    for (const way of [-0.55, 0.55]) {
      surface.circle([x + way * r, y], r * 0.7);
      surface.pen.stroke();
    }
    return;
  }
  if (shape === "circle") surface.circle([x, y], r * 0.8);
  else surface.polygon(PATHS[shape].map(([a, b]) => [x + a * r, y + b * r]));
  surface.pen.fill();
}

// The team from above: robots, goals, trails, radio links, safety discs, cells, walls and obstacles; zoom and pan.
import { cells, links } from "llm-flock-viewer/geometry.js";
import { FONT, Surface, dash, look, theme } from "llm-flock-viewer/surface.js";

const TRAIL = 24; // rounds
const EDGE = 10; // pixels around the arena
const RULER = 22; // pixels below it, for the length to compare with
const MANY = 250; // robots from which on letters and rims are left out

export class Arena {
  constructor(element, runs, clock, options, emit) {
    [this.run] = runs;
    this.clock = clock;
    this.emit = emit;
    this.layers = { ...options.layers };
    this.selected = options.selected || [];
    const keys = "Keys: brackets choose a robot, plus, minus and zero zoom, shift and arrows pan.";
    this.surface = new Surface(element, `Arena of ${options.title}. ${keys}`, () => this.draw());
    this.view = null; // centre and pixels a unit; null fits all
    this.drawn = 0;
    this.pointers = new Map();
    this.forget = clock.listen(() => this.draw());
    this.listen();
    this.surface.fit();
  }

  listen() {
    const canvas = this.surface.canvas;
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY * 0.0015), event.offsetX, event.offsetY);
    }, { passive: false });
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => this.up(event));
    canvas.addEventListener("dblclick", () => this.fit());
    canvas.addEventListener("keydown", (event) => this.key(event));
  }

  down(event) {
    this.surface.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, [event.offsetX, event.offsetY]);
    this.moved = this.pointers.size > 1;
    this.began = [event.offsetX, event.offsetY];
  }

  move(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before || !this.scale) return;
    const here = [event.offsetX, event.offsetY];
    if (this.pointers.size === 2) {
      const [other] = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
      const factor = Math.hypot(here[0] - other[0], here[1] - other[1])
        / Math.max(1, Math.hypot(before[0] - other[0], before[1] - other[1]));
      this.zoom(factor, (here[0] + other[0]) / 2, (here[1] + other[1]) / 2);
    }
    if (this.moved || Math.hypot(here[0] - this.began[0], here[1] - this.began[1]) > 4) {
      this.moved = true;
      const share = this.pointers.size;
      this.pan((here[0] - before[0]) / share, (here[1] - before[1]) / share);
    }
    this.pointers.set(event.pointerId, here);
  }

  up(event) {
    this.pointers.delete(event.pointerId);
    if (event.type === "pointerup" && !this.moved) this.pick(event.offsetX, event.offsetY, event.shiftKey);
  }

  key(event) {
    const by = 40;
    const acts = {
      "+": () => this.zoom(1.25), "=": () => this.zoom(1.25), "-": () => this.zoom(0.8), "0": () => this.fit(),
      "[": () => this.next(-1), "]": () => this.next(1),
    };
    const pans = { ArrowLeft: [by, 0], ArrowRight: [-by, 0], ArrowUp: [0, by], ArrowDown: [0, -by] };
    if (event.shiftKey && pans[event.key]) this.pan(...pans[event.key]);
    else if (acts[event.key]) acts[event.key]();
    else return;
    event.preventDefault();
    event.stopPropagation();
  }

  next(by) {
    if (!this.run.about) return;
    const n = this.run.about.robots;
    const now = this.selected.length ? this.selected[0] : by > 0 ? -1 : 0;
    this.choose((now + by + n) % n, false);
  }

  pick(x, y, second) {
    const frame = this.frame;
    if (!frame) return;
    let best = -1;
    let nearest = Math.max(14, this.radius * 1.3);
    frame.x.forEach((at, robot) => {
      const [px, py] = this.pixel(at);
      const far = Math.hypot(px - x, py - y);
      if (far < nearest) [best, nearest] = [robot, far];
    });
    if (best >= 0) this.choose(best, second);
  }

  choose(robot, second) {
    // Shown at once; the text follows when the server has sent it.
    this.select(second && this.selected.length ? [this.selected[0], robot] : [robot, ...this.selected.slice(1)]);
    this.emit("select", { robot, second });
  }

  select(robots) {
    this.selected = robots;
    this.draw();
  }

  layer(name, on) {
    this.layers[name] = on;
    this.draw();
  }

  fit() {
    this.view = null;
    this.draw();
  }

  pan(x, y) {
    if (!this.scale) return;
    this.view ||= { center: [...this.center], scale: this.scale };
    this.view.center[0] -= x / this.scale;
    this.view.center[1] += y / this.scale;
    this.draw();
  }

  zoom(factor, x = this.surface.width / 2, y = this.surface.height / 2) {
    if (!this.scale) return;
    const at = this.point(x, y);
    this.view ||= { center: [...this.center], scale: this.scale };
    this.view.scale = Math.max(0.02, Math.min(400, this.view.scale * factor));
    this.view.center = [
      at[0] - (x - this.surface.width / 2) / this.view.scale,
      at[1] + (y - this.surface.height / 2) / this.view.scale,
    ];
    this.draw();
  }

  place() {
    const [[left, bottom], [right, top]] = this.run.about.arena;
    const { width, height } = this.surface;
    if (this.view) {
      this.center = this.view.center;
      this.scale = this.view.scale;
      return;
    }
    this.scale = Math.min((width - 2 * EDGE) / (right - left), (height - 2 * EDGE - RULER) / (top - bottom));
    this.center = [(left + right) / 2, (bottom + top) / 2 - RULER / 2 / this.scale];
  }

  pixel([x, y]) {
    return [
      this.surface.width / 2 + (x - this.center[0]) * this.scale,
      this.surface.height / 2 - (y - this.center[1]) * this.scale,
    ];
  }

  point(x, y) {
    return [
      this.center[0] + (x - this.surface.width / 2) / this.scale,
      this.center[1] - (y - this.surface.height / 2) / this.scale,
    ];
  }

  draw() {
    const { surface, run, clock } = this;
    if (!surface.width) return;
    const round = Math.min(clock.round, Math.max(0, run.last));
    const found = run.about ? run.frame(round) : null;
    if (!found) {
      // While a round is on its way, the last picture stays.
      if (!this.frame || !run.about) this.say(run.failure || "Waiting for the first round …");
      else this.picture(this.frame);
      return;
    }
    const after = round < run.last ? run.frame(round + 1) : null;
    const ended = round >= run.last;
    this.picture(clock.part > 0 && after && !ended ? between(found, after, clock.part) : found);
    this.drawn += 1;
    surface.canvas.dataset.round = String(round);
    surface.canvas.dataset.drawn = String(this.drawn);
  }

  say(text) {
    const { pen, width, height } = this.surface;
    this.surface.clear();
    pen.fillStyle = theme().soft;
    pen.font = `14px ${FONT}`;
    pen.textAlign = "center";
    pen.fillText(text, width / 2, height / 2, width - 20);
  }

  picture(frame) {
    const { pen } = this.surface;
    this.frame = frame;
    this.place();
    const about = this.run.about;
    // A disk is as wide as the body, and never too small to be seen and touched.
    this.radius = Math.max(frame.x.length > MANY ? 3 : 9, (about.safe_distance / 2) * this.scale * 0.8);
    this.surface.clear();
    pen.lineJoin = "round";
    this.walls(about);
    if (this.layers.cells) this.cells(frame, about);
    if (this.layers.links) this.links(frame, about);
    if (this.layers.trails) this.trails(frame);
    if (this.layers.goals) this.goals(frame);
    if (this.layers.safety) this.safety(frame, about);
    this.labels(frame);
    this.robots(frame);
    this.ruler();
  }

  walls(about) {
    const { pen } = this.surface;
    const [low, high] = about.arena;
    const [left, bottom] = this.pixel(low);
    const [right, top] = this.pixel(high);
    pen.fillStyle = theme().paper;
    pen.fillRect(left, top, right - left, bottom - top);
    pen.strokeStyle = theme().faint;
    pen.lineWidth = 1;
    pen.setLineDash([]);
    pen.strokeRect(left, top, right - left, bottom - top);
    pen.fillStyle = theme().faint;
    for (const obstacle of about.obstacles) {
      if (obstacle.polygon) this.surface.polygon(obstacle.polygon.map((corner) => this.pixel(corner)));
      else this.surface.circle(this.pixel(obstacle.center), obstacle.radius * this.scale);
      pen.fill();
    }
  }

  cells(frame, about) {
    const { pen } = this.surface;
    pen.lineWidth = 1;
    pen.setLineDash([]);
    const silent = new Set([...frame.d, ...frame.z]);
    cells(frame.x, about.safe_distance, about.arena).forEach((cell, robot) => {
      if (cell.length < 3 || silent.has(robot)) return;
      this.surface.polygon(cell.map((corner) => this.pixel(corner)));
      const { line } = look(this.run, frame.p[robot]);
      pen.globalAlpha = 0.1;
      pen.fillStyle = line;
      pen.fill();
      pen.globalAlpha = 0.55;
      pen.strokeStyle = line;
      pen.stroke();
    });
    pen.globalAlpha = 1;
  }

  links(frame, about) {
    const { pen } = this.surface;
    const silent = new Set([...frame.d, ...frame.z]);
    const pairs = links(frame.x, about.comm_range, silent);
    pen.strokeStyle = theme().soft;
    pen.globalAlpha = Math.max(0.06, Math.min(0.4, 30 / Math.sqrt(pairs.length + 1) / 10));
    pen.lineWidth = 1;
    pen.setLineDash([]);
    pen.beginPath();
    for (const [one, other] of pairs) {
      pen.moveTo(...this.pixel(frame.x[one]));
      pen.lineTo(...this.pixel(frame.x[other]));
    }
    pen.stroke();
    pen.globalAlpha = 1;
  }

  trails(frame) {
    const { pen } = this.surface;
    const rounds = [];
    for (let k = frame.r; k >= Math.max(0, frame.r - TRAIL); k -= 1) {
      const past = this.run.frames.get(k);
      if (!past) {
        if (k > frame.r - 3) this.run.want(k);
        break;
      }
      rounds.push(past);
    }
    if (!rounds.length) return;
    pen.lineWidth = frame.x.length > MANY ? 1 : 2;
    pen.setLineDash([]);
    pen.globalAlpha = 0.45;
    frame.x.forEach((at, robot) => {
      pen.strokeStyle = look(this.run, frame.p[robot]).line;
      pen.beginPath();
      pen.moveTo(...this.pixel(at));
      for (const past of rounds) pen.lineTo(...this.pixel(past.x[robot]));
      pen.stroke();
    });
    pen.globalAlpha = 1;
  }

  goals(frame) {
    const { pen } = this.surface;
    pen.lineWidth = 2;
    frame.g.forEach((goal, robot) => {
      if (!goal) return;
      const { line, rim } = look(this.run, frame.p[robot]);
      pen.strokeStyle = line;
      pen.setLineDash(dash(rim));
      this.surface.circle(this.pixel(goal), this.radius * 1.25);
      pen.stroke();
    });
    pen.setLineDash([]);
    for (const robot of this.selected) {
      if (robot >= frame.x.length || !frame.g[robot]) continue;
      pen.strokeStyle = theme().ink;
      pen.lineWidth = 1.5;
      pen.setLineDash([4, 4]);
      this.surface.line(this.pixel(frame.x[robot]), this.pixel(frame.g[robot]));
    }
    pen.setLineDash([]);
  }

  safety(frame, about) {
    const { pen } = this.surface;
    pen.strokeStyle = theme().warn;
    pen.lineWidth = 1;
    pen.setLineDash([3, 3]);
    for (const at of frame.x) {
      this.surface.circle(this.pixel(at), (about.safe_distance / 2) * this.scale);
      pen.stroke();
    }
    pen.setLineDash([]);
  }

  robots(frame) {
    const { pen } = this.surface;
    const few = frame.x.length <= MANY;
    const dead = new Set(frame.d);
    const asleep = new Set(frame.z);
    const bent = new Set(frame.h);
    const opened = new Set(frame.b);
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    frame.x.forEach((at, robot) => {
      const [x, y] = this.pixel(at);
      const { fill, ink, rim } = look(this.run, frame.p[robot]);
      this.surface.circle([x, y], this.radius);
      pen.fillStyle = dead.has(robot) ? theme().ink : asleep.has(robot) ? theme().faint : fill;
      pen.fill();
      if (few || this.selected.includes(robot)) {
        pen.lineWidth = bent.has(robot) ? 3 : 1.5;
        pen.strokeStyle = bent.has(robot) ? theme().warn : theme().ink;
        pen.setLineDash(dash(rim));
        pen.stroke();
        pen.setLineDash([]);
        if (this.selected.includes(robot)) this.ring(x, y);
        if (opened.has(robot)) this.tag(x, y);
      }
      if (!few && !this.selected.includes(robot)) return;
      const size = Math.max(10, Math.min(16, this.radius * 1.05));
      pen.font = `600 ${size}px ${FONT}`;
      pen.fillStyle = dead.has(robot) || asleep.has(robot) ? theme().paper : ink;
      pen.fillText(dead.has(robot) ? "×" : String(robot), x, y + 0.5);
    });
  }

  /** A square with a G at a robot whose circuit breaker is open: geometry answers for its model. */
  tag(x, y) {
    const { pen } = this.surface;
    const half = Math.max(5, this.radius * 0.45);
    const [left, top] = [x + this.radius * 0.75, y - this.radius * 0.75];
    pen.fillStyle = theme().warn;
    pen.fillRect(left - half, top - half, 2 * half, 2 * half);
    pen.fillStyle = theme().paper;
    pen.font = `700 ${Math.round(half * 1.6)}px ${FONT}`;
    pen.fillText("G", left, top + 0.5);
  }

  /** Letters of plans and influence, below all disks: where robots stand close, their numbers come first. */
  labels(frame) {
    const { pen } = this.surface;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    frame.x.forEach((at, robot) => {
      if (frame.x.length > MANY && !this.selected.includes(robot)) return;
      const [x, y] = this.pixel(at);
      const { name } = look(this.run, frame.p[robot]);
      const label = [this.layers.plans && name, this.layers.influence && frame.i[robot].toFixed(2)]
        .filter(Boolean).join(" ");
      if (!label) return;
      pen.font = `600 11px ${FONT}`;
      pen.lineWidth = 3;
      pen.strokeStyle = theme().paper;
      const above = y - this.radius - (this.selected.includes(robot) ? 15 : 8); // clear of the ring
      pen.strokeText(label, x, above);
      pen.fillStyle = theme().ink;
      pen.fillText(label, x, above);
    });
  }

  /** Marks a selected robot: a ring around the disk, apart from it so that no colour of a plan hides it. */
  ring(x, y) {
    const { pen } = this.surface;
    for (const [wide, ink] of [[6, theme().paper], [3, theme().accent]]) {
      this.surface.circle([x, y], this.radius + 5);
      pen.lineWidth = wide;
      pen.strokeStyle = ink;
      pen.stroke();
    }
  }

  /** A length to compare with. */
  ruler() {
    const { pen, height } = this.surface;
    const rough = 80 / this.scale;
    const power = 10 ** Math.floor(Math.log10(rough));
    const units = power * (rough / power >= 5 ? 5 : rough / power >= 2 ? 2 : 1);
    pen.strokeStyle = pen.fillStyle = theme().soft;
    pen.lineWidth = 2;
    this.surface.line([14, height - 12], [14 + units * this.scale, height - 12]);
    pen.font = `11px ${FONT}`;
    pen.textAlign = "left";
    pen.textBaseline = "bottom";
    pen.fillText(`${Number(units.toPrecision(3))} units`, 14, height - 15);
  }

  close() {
    this.forget();
    this.surface.close();
  }
}

function between(one, other, part) {
  return { ...one, x: one.x.map((at, k) => at.map((value, axis) => value + part * (other.x[k][axis] - value))) };
}

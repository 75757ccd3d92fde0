// The team from above: robots, goals, trails, radio links, safety discs, cells, walls and obstacles.
import { View } from "llm-flock-viewer/arena_view.js";
import { closePairs, fanned, spots, tooNear } from "llm-flock-viewer/crowd.js";
import { cells, links } from "llm-flock-viewer/geometry.js";
import { placed } from "llm-flock-viewer/labels.js";
import { beside, bentRim, between, breakerTag, chosenRing, crowdCounts, crowdTies, describe, planRim, reach, word } from "llm-flock-viewer/robot_signs.js";
import { FONT, Surface, dash, look, theme } from "llm-flock-viewer/surface.js";

const TRAIL = 24; // rounds
const MANY = 250; // robots from which on letters and rims are left out
const MAX_WORDS = [30, MANY]; // robots from which on there is no room for words, beside small disks and beside others
const BODY = 0.8; // of a safety disc: two discs touch before two bodies do
const SHARE = 0.36; // of the spacing: neighbours in a formation stand apart
const BUTTONS = [290, 40]; // pixels of the buttons in the corner, which no word is to touch

/** Whether two places can be told apart. */
function away([ax, ay], [bx, by]) {
  return Math.abs(ax - bx) + Math.abs(ay - by) > 0.5;
}

export class Arena {
  constructor(element, run, clock, options, pick) {
    this.run = run;
    this.clock = clock;
    this.pick = pick;
    this.layers = { ...options.layers };
    this.selected = [];
    this.surface = new Surface(element, `Arena of ${options.title}: the team from above. ? lists the keys.`, () => this.draw());
    this.view = new View(this.surface, () => this.draw());
    this.drawn = 0;
    this.at = [];
    this.forget = clock.listen(() => this.draw());
    this.view.listen((event) => this.picked(event), (event) => this.hover(event));
    this.surface.canvas.addEventListener("pointerleave", () => this.surface.tip(null));
    this.surface.fit();
  }

  next(by) {
    if (!this.run.about) return;
    const n = this.run.about.robots;
    const now = this.selected.length ? this.selected[0] : by > 0 ? -1 : 0;
    this.choose((now + by + n) % n, false);
  }

  /** The robot at a place of the canvas, or -1. */
  robotAt(x, y) {
    let best = -1;
    let nearest = Math.max(14, this.radius * 1.3);
    this.at.forEach(([px, py], robot) => {
      const far = Math.hypot(px - x, py - y);
      if (far < nearest) [best, nearest] = [robot, far];
    });
    return best;
  }

  picked(event) {
    const robot = this.frame ? this.robotAt(event.offsetX, event.offsetY) : -1;
    if (robot >= 0) this.choose(robot, event.shiftKey);
  }

  hover(event) {
    this.surface.tip(this.frame ? this.words(event.offsetX, event.offsetY) : null, event.offsetX, event.offsetY);
  }

  /** What is at a place of the canvas, in words; null where nothing is. */
  words(x, y) {
    const { frame, run } = this;
    const robot = this.robotAt(x, y);
    if (robot >= 0) return describe(run, frame, robot);
    const goal = !this.layers.goals ? -1
      : frame.g.findIndex((at) => at && Math.hypot(...this.pixel(at).map((value, axis) => value - [x, y][axis])) < this.radius * 1.5);
    if (goal >= 0) {
      return `Goal of robot ${goal}: place ${frame.s[goal] ?? "?"} of plan ${look(run, frame.p[goal]).name || "?"}`;
    }
    const link = (this.linked || []).find(([one, other]) => beside([x, y], this.pixel(frame.x[one]), this.pixel(frame.x[other])) < 4);
    if (!link) return null;
    const far = Math.hypot(...frame.x[link[0]].map((value, axis) => value - frame.x[link[1]][axis]));
    return `Radio link of robots ${link[0]} and ${link[1]}: ${far.toFixed(1)} units`;
  }

  choose(robot, second) {
    // Shown at once; the text follows when the server has sent it.
    this.select(second && this.selected.length ? [this.selected[0], robot] : [robot, ...this.selected.slice(1)]);
    this.pick(robot, second);
  }

  pixel(at) {
    return this.view.pixel(at);
  }

  select(robots) {
    this.selected = robots;
    this.draw();
  }

  layer(name, on) {
    this.layers[name] = on;
    this.draw();
  }

  draw() {
    const { surface, run, clock } = this;
    if (!surface.width) return;
    const round = Math.min(clock.round, Math.max(0, run.last));
    const found = run.about ? run.frame(round) : null;
    if (!found) {
      // While a round is on its way, the last picture stays.
      if (!this.frame || !run.about) this.say(run.failure || "Starting: waiting for the first round …");
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
    const about = this.run.about;
    this.view.place(about.arena, { way: this.run.extent, formation: this.run.formation }, about.safe_distance);
    this.scale = this.view.scale;
    // A disk is as wide as the body; where that is too small to be seen and touched it is larger, but not beside safety
    // discs, which are to be larger than bodies.
    const body = (about.safe_distance / 2) * this.scale * BODY;
    const least = frame.x.length > MANY ? 3 : Math.min(9, SHARE * about.spacing * this.scale);
    this.radius = Math.max(3, body, this.layers.safety ? 0 : least);
    const pixels = frame.x.map((at) => this.pixel(at));
    const { at, crowds } = frame.x.length > MANY ? { at: pixels, crowds: [] } : fanned(pixels, this.radius);
    this.at = at;
    // Between two rounds the pairs of a large team are those of the round before: counting takes longer than drawing.
    if (frame.x.length <= MANY || frame.r !== this.numbered) this.near = closePairs(frame.x, about.safe_distance);
    this.numbered = frame.r;
    tooNear(crowds, this.near);
    this.surface.clear();
    pen.lineJoin = "round";
    this.walls(about);
    if (this.layers.cells && !about.space) this.cells(frame, about); // cells of space have no outline from above
    this.linked = [];
    this.ways = [];
    if (this.layers.links) this.links(frame, about);
    if (this.layers.trails) this.trails(frame);
    if (this.layers.goals) this.goals(frame);
    crowdTies(this.surface, crowds, pixels, this.at);
    this.tooClose();
    this.robots(frame);
    this.labels(frame, crowds);
    if (this.layers.safety) this.safety(frame, about); // above the rims, which are wider where the picture is small
    crowdCounts(this.surface, crowds);
    this.ruler();
    this.surface.canvas.dataset.scale = this.scale.toPrecision(4);
    this.surface.canvas.dataset.crowds = crowds.map(({ members, near }) => `${members.length}${near ? " too near" : ""}`).join();
    this.surface.canvas.dataset.near = String(this.near.length);
    this.surface.canvas.dataset.links = String(this.linked.length);
    this.surface.canvas.dataset.radius = this.radius.toPrecision(4);
  }

  /** Pairs nearer than the safe distance, in red. */
  tooClose() {
    const { pen } = this.surface;
    pen.strokeStyle = theme().danger;
    pen.lineWidth = 4;
    pen.setLineDash([]);
    for (const [one, other] of this.near) {
      this.surface.line(this.at[one], this.at[other]);
      for (const k of [one, other]) {
        this.surface.circle(this.at[k], this.radius + 3);
        pen.stroke();
      }
    }
  }

  walls(about) {
    const { pen } = this.surface;
    pen.strokeStyle = theme().faint;
    pen.lineWidth = 1;
    pen.setLineDash([]);
    this.surface.polygon(this.walled(about));
    pen.stroke();
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
    this.linked = pairs;
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
      const way = [at, ...rounds.map((past) => past.x[robot])].map((place) => this.pixel(place));
      pen.beginPath();
      way.forEach((place, k) => pen[k ? "lineTo" : "moveTo"](...place));
      pen.stroke();
      // Robots that stand have no way; those of a large team leave no room beside them.
      if (frame.x.length <= MAX_WORDS[0]) for (let k = 1; k < way.length; k += 1) if (away(way[k - 1], way[k])) this.ways.push([way[k - 1], way[k]]);
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
    pen.strokeStyle = theme().danger;
    pen.lineWidth = 1.5;
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
    // Below all disks: no ring of one robot hides the number of another.
    for (const robot of this.selected) if (this.at[robot]) chosenRing(this.surface, ...this.at[robot], this.radius);
    if (few) for (const robot of frame.h) bentRim(this.surface, ...this.at[robot], this.radius);
    this.at.forEach(([x, y], robot) => {
      const { fill, ink, rim } = look(this.run, frame.p[robot]);
      this.surface.circle([x, y], this.radius);
      pen.fillStyle = dead.has(robot) ? theme().ink : asleep.has(robot) ? theme().faint : fill;
      pen.fill();
      if (few || this.selected.includes(robot)) {
        if (bent.has(robot) && !few) bentRim(this.surface, x, y, this.radius);
        planRim(this.surface, x, y, this.radius, rim);
        if (opened.has(robot)) breakerTag(this.surface, x, y, this.radius);
      }
      if (!few && !this.selected.includes(robot)) return;
      if (this.radius < 6) return; // the label beside it has the number
      const size = Math.max(10, Math.min(16, this.radius * 1.05));
      pen.font = `600 ${size}px ${FONT}`;
      pen.fillStyle = dead.has(robot) || asleep.has(robot) ? theme().paper : ink;
      pen.fillText(dead.has(robot) ? "×" : String(robot), x, y + 0.5);
    });
  }

  /** Letters of plans, influence and what else is said beside a disk; left out where there is no room. */
  labels(frame, crowds) {
    if (this.at.length > MANY && !this.selected.length) return;
    const { width, height } = this.surface;
    const bent = new Set(frame.h);
    const opened = new Set(frame.b);
    const close = new Set(this.near.flat());
    const dead = new Set(frame.d);
    const words = this.at.map((_, robot) => {
      if (this.at.length > MAX_WORDS[this.radius < 6 ? 0 : 1] && !this.selected.includes(robot)) return null;
      const letters = this.layers.plans && !dead.has(robot) ? look(this.run, frame.p[robot]) : null;
      // A disk that is too small, or has a cross in it, has its number beside it.
      const beside = [(this.radius < 6 || dead.has(robot)) && String(robot), this.layers.influence && !dead.has(robot) && frame.i[robot].toFixed(2)];
      return word(this.surface, letters, beside.filter(Boolean).join(" "));
    });
    const disks = this.at.map(([x, y], robot) => [x, y, reach(this.radius,
      { bent: bent.has(robot), opened: opened.has(robot), close: close.has(robot), chosen: this.selected.includes(robot) })]);
    const corners = [[width - BUTTONS[0], height - BUTTONS[1], width, height], [0, height - 34, this.run.about.space ? 200 : 110, height]];
    const taken = [...corners, ...spots(crowds, disks, this.radius, [width, height], corners)];
    const before = this.offsets && this.offsets.length === words.length ? this.offsets : [];
    this.offsets = placed(disks, words.map((one) => one && [one.wide, 14]), [width, height], taken, before, this.outlines(frame));
    this.offsets.forEach((offset, robot) => {
      if (offset) words[robot].draw(this.at[robot][0] + offset[0], this.at[robot][1] + offset[1]);
    });
    this.surface.canvas.dataset.words = String(this.offsets.filter(Boolean).length);
  }

  /** What words cross only where there is no other room: rings, ways, walls, ties and what is chosen. */
  outlines(frame) {
    const { about } = this.run;
    const ends = this.walled(about);
    const edges = (corners) => corners.map((corner, k) => [corner, corners[(k + 1) % corners.length]]);
    const rings = this.layers.goals ? frame.g.filter(Boolean).map((goal) => [...this.pixel(goal), this.radius * 1.25]) : [];
    const lines = edges(ends);
    for (const obstacle of about.obstacles) {
      if (obstacle.polygon) lines.push(...edges(obstacle.polygon.map((corner) => this.pixel(corner))));
      else rings.push([...this.pixel(obstacle.center), obstacle.radius * this.scale]);
    }
    return { rings, lines: lines.concat(this.ways) };
  }

  walled(about) {
    const [[left, bottom], [right, top]] = about.arena;
    return [[left, bottom], [right, bottom], [right, top], [left, top]].map((corner) => this.pixel(corner));
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
    const text = `${Number(units.toPrecision(3))} units${this.run.about.space ? " · seen from above" : ""}`;
    pen.strokeStyle = theme().paper;
    pen.lineWidth = 4;
    pen.strokeText(text, 14, height - 15);
    pen.fillText(text, 14, height - 15);
  }

  close() {
    this.forget();
    this.surface.close();
  }
}

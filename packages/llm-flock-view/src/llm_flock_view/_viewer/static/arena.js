// The team from above, or in space: robots, goals, trails, radio links, safety discs, cells, walls and obstacles.
import { View, corners } from "llm-flock-viewer/arena_view.js";
import { closePairs, fanned, spots, tooNear } from "llm-flock-viewer/crowd.js";
import { cells, links } from "llm-flock-viewer/geometry.js";
import { placed } from "llm-flock-viewer/labels.js";
import { beside, bentRim, between, breakerTag, chosenRing, crowdCounts, crowdTies, describe, planRim, reach, word } from "llm-flock-viewer/robot_signs.js";
import { FONT, Surface, dash, look, theme } from "llm-flock-viewer/surface.js";

const TRAIL = 24; // rounds
const MANY = 250; // robots from which on letters and rims are left out
export const CROWD = 30; // robots from which on plans have areas with one tag each, and words stand at chosen robots only
const AREA = 0.75; // of the spacing: areas of neighbours meet
const BODY = 0.8; // of a safety disc: two discs touch before two bodies do
const SHARE = 0.36; // of the spacing: neighbours in a formation stand apart
const BUTTONS = [290, 40]; // pixels of the buttons in the corner, which no word is to touch

/** The box around boxes: lowest and then highest coordinates. */
function union(boxes) {
  if (boxes.length < 2) return boxes[0] || [];
  return boxes[0].map((_, k) => Math[k < boxes[0].length / 2 ? "min" : "max"](...boxes.map((box) => box[k])));
}

/** The box around places. */
function boxAround(places) {
  return [Math.min, Math.max].flatMap((end) => places[0].map((_, axis) => end(...places.map((at) => at[axis]))));
}

/** Whether two places can be told apart. */
function away([ax, ay], [bx, by]) {
  return Math.abs(ax - bx) + Math.abs(ay - by) > 0.5;
}

export class Arena {
  constructor(element, run, clock, options, pick) {
    Object.assign(this, { run, clock, pick, layers: { ...options.layers }, selected: [], hovered: -1, drawn: 0, at: [] });
    this.surface = new Surface(element, `Arena of ${options.title}: the team. ? lists the keys.`, () => this.draw());
    this.view = new View(this.surface, () => clock.changed(), options.chosen);
    this.peers = options.peers; // runs that are drawn to the same scale
    clock.listen(() => this.draw());
    this.view.listen((event) => this.picked(event), (event) => this.hover(event));
    this.surface.canvas.addEventListener("pointerleave", () => {
      this.surface.tip(null);
      this.point(-1);
    });
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

  /** Mark the robot under the pointer, or -1: in a crowd it gets its number. */
  point(robot) {
    if (robot !== this.hovered) this.clock.changed();
    this.hovered = robot;
  }

  hover(event) {
    if (this.frame) this.point(this.robotAt(event.offsetX, event.offsetY));
    this.surface.tip(this.frame ? this.words(event.offsetX, event.offsetY) : null, event.offsetX, event.offsetY);
  }

  /** What is at a place of the canvas, in words; null where nothing is. */
  words(x, y) {
    const { frame, run } = this;
    const robot = this.robotAt(x, y);
    if (robot >= 0) return describe(run, frame, robot);
    const goal = !this.layers.goals ? -1
      : frame.g.findIndex((at) => at && Math.hypot(this.pixel(at)[0] - x, this.pixel(at)[1] - y) < this.radius * 1.5);
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
    const peers = this.peers.filter((run) => run.about && run.about.space === about.space);
    const all = (name) => union(peers.map((run) => run[name]).filter((box) => box.length));
    const arena = union(peers.map((run) => run.about.arena.flat()));
    this.view.place([arena.slice(0, arena.length / 2), arena.slice(arena.length / 2)], { way: all("extent"), formation: all("formation"), team: about.space ? boxAround([...frame.x, ...frame.g.filter(Boolean)]) : [] }, about.safe_distance);
    this.scale = this.view.scale;
    // A disk is as wide as the body; where that is too small to be seen and touched it is larger, but not beside safety
    // discs, which are to be larger than bodies.
    const body = (about.safe_distance / 2) * this.scale * BODY;
    const least = frame.x.length > MANY ? 3 : Math.min(9, SHARE * about.spacing * this.scale);
    this.radius = Math.max(3, body, this.layers.safety ? 0 : least);
    const pixels = frame.x.map((at) => this.pixel(at));
    const { at, crowds } = frame.x.length > MANY ? { at: pixels, crowds: [] } : fanned(pixels, this.radius, this.deep);
    this.at = at;
    this.foot = about.arena[0][2] || 0;
    // Between two rounds the pairs of a large team are those of the round before: counting takes longer than drawing.
    if (frame.x.length <= MANY || frame.r !== this.numbered) this.near = closePairs(frame.x, about.safe_distance, about.downwash);
    this.numbered = frame.r;
    tooNear(crowds, this.near);
    this.surface.clear();
    pen.lineJoin = "round";
    this.walls(about);
    if (this.layers.cells && !about.space) this.cells(frame, about); // cells of space have no outline from above
    this.linked = [];
    this.ways = [];
    this.crowded = frame.x.length > CROWD;
    if (this.crowded && this.layers.plans) this.areas(frame, about);
    if (about.space) this.drops(frame);
    if (this.layers.links) this.links(frame, about, pixels);
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
    this.surface.canvas.dataset.at = at.length ? at[0].slice(0, 2).map(Math.round).join() : "";
    this.surface.canvas.dataset.near = String(this.near.length);
    this.surface.canvas.dataset.links = String(this.linked.length);
    this.surface.canvas.dataset.radius = this.radius.toPrecision(4);
  }

  /** Pairs nearer than the safe distance, in red. */
  tooClose() {
    const { pen } = this.surface;
    pen.strokeStyle = theme().danger;
    pen.lineWidth = 4;
    for (const [one, other] of this.near) {
      this.surface.line(this.at[one], this.at[other]);
      for (const k of [one, other]) {
        this.surface.circle(this.at[k], this.radius + 3);
        pen.stroke();
      }
    }
  }

  /** Whether space is seen in perspective. */
  get deep() {
    return Boolean(this.view.camera && !this.view.camera.flat);
  }

  /** How large a disk of a radius is at a place of the canvas: what is nearer in space is larger. */
  sized(at, radius = this.radius) {
    return radius * (at[2] || 1);
  }

  walls(about) {
    const { pen } = this.surface;
    pen.strokeStyle = theme().faint;
    pen.lineWidth = 1;
    if (this.deep) {
      pen.fillStyle = theme().grid;
      pen.globalAlpha = 0.35;
      const [[left, bottom], [right, top]] = about.arena;
      this.surface.polygon([[left, bottom], [right, bottom], [right, top], [left, top]].map((corner) => this.pixel([...corner, this.foot])));
      pen.fill();
      pen.globalAlpha = 1;
    }
    for (const edge of this.edges(about)) this.surface.line(...edge);
    pen.fillStyle = theme().faint;
    for (const obstacle of about.obstacles) {
      if (obstacle.polygon) this.surface.polygon(obstacle.polygon.map((corner) => this.pixel(corner)));
      else this.surface.circle(this.pixel(obstacle.center), this.sized(this.pixel(obstacle.center), obstacle.radius * this.scale));
      pen.fill();
    }
  }

  /** The sides of the arena as they are seen [pixels]: corners of a box are joined where one coordinate differs. */
  edges(about) {
    const at = corners(...about.arena).map((corner) => this.pixel(corner));
    return at.flatMap((one, i) => at.flatMap((other, j) => (i < j && [1, 2, 4].includes(i ^ j) ? [[one, other]] : [])));
  }

  /** The places of a plan's robots as one area of its colour. */
  areas(frame, about) {
    const { pen } = this.surface;
    const silent = new Set([...frame.d, ...frame.z]);
    pen.globalAlpha = 0.2;
    for (const plan of new Set(frame.p)) {
      if (plan < 0) continue;
      pen.fillStyle = look(this.run, plan).fill;
      pen.beginPath();
      frame.p.forEach((own, robot) => {
        if (own !== plan || silent.has(robot)) return;
        const radius = Math.max(this.radius + 3, this.sized(this.at[robot], AREA * about.spacing * this.scale));
        pen.moveTo(this.at[robot][0] + radius, this.at[robot][1]);
        pen.arc(...this.at[robot].slice(0, 2), radius, 0, 2 * Math.PI);
      });
      pen.fill();
    }
    pen.globalAlpha = 1;
  }

  /** Lines from robots down to the ground, which tell where they are. */
  drops(frame) {
    if (this.view.camera.flat === "top") return;
    const { pen } = this.surface;
    pen.strokeStyle = pen.fillStyle = theme().soft;
    pen.lineWidth = 1;
    pen.globalAlpha = 0.7;
    pen.beginPath();
    const feet = frame.x.map(([x, y]) => this.pixel([x, y, this.foot]));
    feet.forEach((foot, robot) => {
      pen.moveTo(this.at[robot][0], this.at[robot][1]);
      pen.lineTo(foot[0], foot[1]);
    });
    pen.stroke();
    for (const [x, y] of feet) pen.fillRect(x - 2, y - 1, 4, 2);
    pen.globalAlpha = 1;
  }

  cells(frame, about) {
    const { pen } = this.surface;
    pen.lineWidth = 1;
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

  links(frame, about, pixels) {
    const { pen } = this.surface;
    const silent = new Set([...frame.d, ...frame.z]);
    const pairs = links(frame.x, about.comm_range, silent);
    this.linked = pairs;
    pen.strokeStyle = theme().soft;
    pen.globalAlpha = Math.max(0.06, Math.min(0.4, 30 / Math.sqrt(pairs.length + 1) / 10));
    pen.lineWidth = 1;
    pen.beginPath();
    for (const [one, other] of pairs) {
      pen.moveTo(pixels[one][0], pixels[one][1]);
      pen.lineTo(pixels[other][0], pixels[other][1]);
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
    pen.globalAlpha = 0.45;
    frame.x.forEach((at, robot) => {
      pen.strokeStyle = look(this.run, frame.p[robot]).line;
      const way = [at, ...rounds.map((past) => past.x[robot])].map((place) => this.pixel(place));
      pen.beginPath();
      way.forEach((place, k) => pen[k ? "lineTo" : "moveTo"](...place));
      pen.stroke();
      // Robots that stand have no way; those of a large team leave no room beside them.
      if (frame.x.length <= CROWD) for (let k = 1; k < way.length; k += 1) if (away(way[k - 1], way[k])) this.ways.push([way[k - 1], way[k]]);
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
      this.surface.circle(this.pixel(goal), 1.25 * this.sized(this.pixel(goal)));
      pen.stroke();
    });
    pen.setLineDash([]);
    for (const robot of this.selected) {
      if (robot >= frame.x.length || !frame.g[robot]) continue;
      pen.strokeStyle = theme().ink;
      pen.lineWidth = 1.5;
      this.surface.line(this.pixel(frame.x[robot]), this.pixel(frame.g[robot]), [4, 4]);
    }
  }

  safety(frame, about) {
    const { pen } = this.surface;
    pen.strokeStyle = theme().danger;
    pen.lineWidth = 1.5;
    pen.setLineDash([3, 3]);
    for (const at of frame.x) {
      this.surface.circle(this.pixel(at), this.sized(this.pixel(at), (about.safe_distance / 2) * this.scale));
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
    for (const robot of this.selected) if (this.at[robot]) chosenRing(this.surface, ...this.at[robot].slice(0, 2), this.sized(this.at[robot]));
    if (few) for (const robot of frame.h) bentRim(this.surface, ...this.at[robot].slice(0, 2), this.sized(this.at[robot]));
    const order = this.at.map((_, robot) => robot);
    if (this.deep) order.sort((one, other) => this.at[one][2] - this.at[other][2]); // the farthest first
    order.forEach((robot) => {
      const [x, y] = this.at[robot];
      const radius = this.sized(this.at[robot]);
      const { fill, ink, rim } = look(this.run, frame.p[robot]);
      this.surface.circle([x, y], radius);
      pen.fillStyle = dead.has(robot) ? theme().ink : asleep.has(robot) ? theme().faint : fill;
      pen.fill();
      if (few || this.selected.includes(robot)) {
        if (bent.has(robot) && !few) bentRim(this.surface, x, y, radius);
        planRim(this.surface, x, y, radius, rim);
        if (opened.has(robot)) breakerTag(this.surface, x, y, radius);
      }
      if (!few && !this.selected.includes(robot)) return;
      if (this.radius < 6) return; // the label beside it has the number
      const size = Math.max(10, Math.min(16, radius * 1.05));
      pen.font = `600 ${size}px ${FONT}`;
      pen.fillStyle = dead.has(robot) || asleep.has(robot) ? theme().paper : ink;
      pen.fillText(dead.has(robot) ? "×" : String(robot), x, y + 0.5);
    });
  }

  /** Letters of plans, influence and what else is said beside a disk; left out where there is no room. */
  labels(frame, crowds) {
    if (this.at.length > MANY && !this.selected.length && this.hovered < 0) return;
    const { width, height } = this.surface;
    const bent = new Set(frame.h);
    const opened = new Set(frame.b);
    const close = new Set(this.near.flat());
    const dead = new Set(frame.d);
    const silent = new Set([...frame.d, ...frame.z]);
    const { space } = this.run.about;
    // In a crowd each plan has its tag once, at its highest robot in the picture.
    const tagged = new Map();
    if (this.crowded) frame.p.forEach((plan, robot) => { if (!silent.has(robot) && (!tagged.has(plan) || this.at[robot][1] < this.at[tagged.get(plan)][1])) tagged.set(plan, robot); });
    const words = this.at.map((_, robot) => {
      const own = !this.crowded || this.selected.includes(robot) || robot === this.hovered;
      const letters = this.layers.plans && !dead.has(robot) && (own || tagged.get(frame.p[robot]) === robot) ? look(this.run, frame.p[robot]) : null;
      // A disk that is too small, or has a cross in it, has its number beside it.
      const beside = [(this.radius < 6 || dead.has(robot)) && own && String(robot), space && own && `↕${frame.x[robot][2].toFixed(0)}`,
        this.layers.influence && !dead.has(robot) && (own || this.radius >= 6) && frame.i[robot].toFixed(2)];
      return word(this.surface, letters, beside.filter(Boolean).join(" "));
    });
    const disks = this.at.map(([x, y], robot) => [x, y, reach(this.sized(this.at[robot]),
      { bent: bent.has(robot), opened: opened.has(robot), close: close.has(robot), chosen: this.selected.includes(robot) })]);
    const corners = [[width - BUTTONS[0], height - BUTTONS[1], width, height], [0, height - 34, space ? 200 : 110, height]];
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
    const sides = (ends) => ends.map((end, k) => [end, ends[(k + 1) % ends.length]]);
    const ring = (at, radius) => [...at.slice(0, 2), this.sized(at, radius)];
    const rings = this.layers.goals ? frame.g.filter(Boolean).map((goal) => ring(this.pixel(goal), this.radius * 1.25)) : [];
    const lines = this.edges(about);
    for (const obstacle of about.obstacles) {
      if (obstacle.polygon) lines.push(...sides(obstacle.polygon.map((corner) => this.pixel(corner))));
      else rings.push(ring(this.pixel(obstacle.center), obstacle.radius * this.scale));
    }
    return { rings, lines: lines.concat(this.ways) };
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
    const text = `${Number(units.toPrecision(3))} units${{ top: " · seen from above", side: " · seen from the side" }[this.view.camera?.flat] || (this.deep ? " in the middle of space" : "")}`;
    pen.strokeStyle = theme().paper;
    pen.lineWidth = 4;
    pen.strokeText(text, 14, height - 15);
    pen.fillText(text, 14, height - 15);
  }
}

// Signs at a robot beside its disk, and a robot in words.
import { FONT, dash, look, theme } from "llm-flock-viewer/surface.js";

const MONO = "ui-monospace, 'DejaVu Sans Mono', monospace"; // a letter I has serifs in it, and is no tick

/** Rims of small disks are thinner, so that neighbours in a formation stay apart. */
function thinner(radius) {
  return Math.min(1, radius / 9);
}

/** How far a disk goes with all that is around it [pixels]. */
export function reach(radius, { bent, opened, close, chosen }) {
  const thin = thinner(radius);
  return radius + Math.max(2 * thin, bent ? 7 * thin : 0, opened ? 8 : 0, close ? 5 : 0, chosen ? 12 : 0);
}

/** A word beside a disk: letters of a plan on a tag in its colour, then other text. Null for no word. */
export function word(surface, plan, text) {
  const { pen } = surface;
  const letters = plan ? plan.name : "";
  if (!letters && !text) return null;
  pen.font = `700 11px ${MONO}`;
  const tag = letters ? pen.measureText(letters).width + 6 : 0;
  pen.font = `600 11px ${FONT}`;
  const wide = tag + (text ? pen.measureText(text).width + (tag ? 3 : 0) : 0);
  const draw = (x, y) => {
    pen.setLineDash([]);
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    if (letters) {
      // On a tag in the plan's colour: no letter is taken for a stroke of the picture.
      pen.fillStyle = plan.fill;
      pen.fillRect(x - wide / 2, y - 7, tag, 13);
      pen.lineWidth = 1;
      pen.strokeStyle = theme().paper;
      pen.strokeRect(x - wide / 2, y - 7, tag, 13);
      pen.font = `700 11px ${MONO}`;
      pen.fillStyle = plan.ink;
      pen.fillText(letters, x - wide / 2 + tag / 2, y);
    }
    if (!text) return;
    pen.font = `600 11px ${FONT}`;
    pen.textAlign = "right";
    pen.lineWidth = 3;
    pen.strokeStyle = theme().paper;
    pen.strokeText(text, x + wide / 2, y);
    pen.fillStyle = theme().ink;
    pen.fillText(text, x + wide / 2, y);
  };
  return { wide, draw };
}

/** The rim of a plan, around the disk: on paper, so that its dashes are seen beside every colour, however small. */
export function planRim(surface, x, y, radius, rim) {
  const { pen } = surface;
  const thin = thinner(radius);
  surface.circle([x, y], radius + thin);
  pen.lineWidth = 4 * thin;
  pen.strokeStyle = theme().paper;
  pen.stroke();
  pen.lineWidth = 2 * thin;
  pen.strokeStyle = theme().ink;
  pen.setLineDash(dash(rim).map((length) => length * Math.max(0.6, Math.min(1.5, radius / 9))));
  pen.stroke();
  pen.setLineDash([]);
}

/** A rim apart from the disk and edged in ink, so that it is seen on every colour of a plan. */
export function bentRim(surface, x, y, radius) {
  const { pen } = surface;
  const thin = thinner(radius);
  for (const [wide, ink, far] of [[5.5, theme().ink, 4], [3, theme().bent, 4], [2, theme().paper, 1]]) {
    surface.circle([x, y], radius + far * thin);
    pen.lineWidth = wide * thin;
    pen.strokeStyle = ink;
    pen.stroke();
  }
}

/** A square with an exclamation mark at a robot whose circuit breaker is open; a letter would be taken for a plan. */
export function breakerTag(surface, x, y, radius) {
  const { pen } = surface;
  const half = Math.max(5, radius * 0.45);
  const [left, top] = [x + radius * 0.75, y - radius * 0.75];
  pen.fillStyle = theme().warn;
  pen.fillRect(left - half, top - half, 2 * half, 2 * half);
  pen.fillStyle = theme().paper;
  pen.font = `700 ${Math.round(half * 1.6)}px ${FONT}`;
  pen.fillText("!", left, top + 0.5);
}

/** Marks a selected robot: a ring around the disk, apart from it so that no colour of a plan hides it. */
export function chosenRing(surface, x, y, radius) {
  const { pen } = surface;
  for (const [wide, ink] of [[6, theme().paper], [3, theme().accent]]) {
    surface.circle([x, y], radius + 9);
    pen.lineWidth = wide;
    pen.strokeStyle = ink;
    pen.stroke();
  }
}

/** Disks that fanned out are tied to where their robots are: in red where two of them are too near in space. */
export function crowdTies(surface, crowds, pixels, at) {
  surface.pen.setLineDash([]);
  surface.pen.lineWidth = 1.5;
  for (const { members, near } of crowds) {
    surface.pen.strokeStyle = near ? theme().danger : theme().soft;
    for (const k of members) surface.line(pixels[k], at[k]);
  }
}

/** How many robots are in one place of the picture, in its middle or beside it. */
export function crowdCounts(surface, crowds) {
  const { pen } = surface;
  pen.font = `700 11px ${FONT}`;
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  for (const { members, spot, near } of crowds) {
    if (!spot) continue;
    const text = `${members.length}×`;
    const wide = pen.measureText(text).width + 6;
    pen.fillStyle = near ? theme().danger : theme().soft;
    pen.fillRect(spot[0] - wide / 2, spot[1] - 7, wide, 14);
    pen.fillStyle = theme().paper;
    pen.fillText(text, spot[0], spot[1] + 0.5);
  }
}

/** A robot in words. */
export function describe(run, frame, robot) {
  const plan = look(run, frame.p[robot]).name;
  const parts = [`Robot ${robot}`];
  if (frame.d.includes(robot)) return `${parts[0]} is dead`;
  if (frame.z.includes(robot)) return `${parts[0]} has not begun yet`;
  parts.push(plan ? `plan ${plan}, ${frame.s[robot] === null ? "no place" : `place ${frame.s[robot]}`}` : "no plan");
  parts.push(`heard by ${Math.round(100 * frame.i[robot])} % of the team`);
  if (frame.x[robot].length > 2) parts.push(`height ${frame.x[robot][2].toFixed(1)} units`);
  if (frame.h.includes(robot)) parts.push("not moved as its model wanted");
  if (frame.b.includes(robot)) parts.push("its model is not asked (circuit breaker open)");
  return parts.join(" · ");
}

/** Distance of a point from a line between two others [pixels]. */
export function beside([x, y], [ax, ay], [bx, by]) {
  const long = (bx - ax) ** 2 + (by - ay) ** 2;
  const share = long ? Math.max(0, Math.min(1, ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / long)) : 0;
  return Math.hypot(ax + share * (bx - ax) - x, ay + share * (by - ay) - y);
}

/** A picture between two rounds; `part` is the share of the way. */
export function between(one, other, part) {
  return { ...one, x: one.x.map((at, k) => at.map((value, axis) => value + part * (other.x[k][axis] - value))) };
}

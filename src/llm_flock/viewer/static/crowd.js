// Robots that stand too close: pairs to be shown in red, and where the disks of a crowd are drawn so that all are seen.
import { links } from "llm-flock-viewer/geometry.js";

const ROUNDING = 1e-6; // units; as the server counts pairs
const COUNT = 13; // pixels between the middle of a crowd and its disks, for the number in it
const APART = 1.6; // radii, and two pixels of rims, from which on one disk leaves the number of another in sight
const PASSES = 4; // each move may bring a disk near another
const TURNS = 12; // angles that are tried for a crowd among others

/** Pairs nearer than the safe distance. */
export function closePairs(points, safe) {
  return links(points, safe - ROUNDING, new Set());
}

/** Where disks are drawn [pixels]: those that hide one another fan out around their middle, the others' numbers stay in sight. */
export function fanned(pixels, radius) {
  const apart = APART * radius + 2;
  const near = links(pixels, apart, new Set());
  if (!near.length) return { at: pixels, crowds: [] };
  const far = ([one, other]) => Math.hypot(pixels[one][0] - pixels[other][0], pixels[one][1] - pixels[other][1]);
  const at = pixels.map((place) => [...place]);
  const crowds = groups(pixels.length, near.filter((pair) => far(pair) < 0.9 * radius)).map((members) => {
    const middle = [0, 1].map((axis) => members.reduce((sum, k) => sum + pixels[k][axis], 0) / members.length);
    fan(at, members, middle, Math.max(radius + COUNT, (members.length * (radius + 4)) / Math.PI));
    return { members, middle };
  });
  // A little aside: less than a robot's radius, and nothing to be told.
  for (let pass = 0; pass < PASSES; pass += 1) {
    for (const [one, other] of links(at, apart, new Set())) {
      const [dx, dy] = [at[other][0] - at[one][0], at[other][1] - at[one][1]];
      const gap = Math.hypot(dx, dy) || 1;
      const by = (apart - gap) / 2 / gap;
      at[one] = [at[one][0] - dx * by, at[one][1] - dy * by];
      at[other] = [at[other][0] + dx * by, at[other][1] + dy * by];
    }
    for (const { middle } of crowds) {
      at.forEach((place, k) => {
        const [dx, dy] = [place[0] - middle[0], place[1] - middle[1]];
        const gap = Math.hypot(dx, dy) || 1;
        if (gap < radius + COUNT) at[k] = [middle[0] + (dx / gap) * (radius + COUNT), middle[1] + (dy / gap) * (radius + COUNT)];
      });
    }
  }
  // A number is left out where there is no room for it: the disks that fan out say the same.
  const clear = ({ middle }, k) => at.every((place) => Math.hypot(place[0] - middle[0], place[1] - middle[1]) > radius + COUNT - 3)
    && crowds.every((other, j) => j === k || Math.hypot(other.middle[0] - middle[0], other.middle[1] - middle[1]) > 2 * COUNT);
  return { at, crowds: crowds.map((crowd, k) => ({ ...crowd, counted: clear(crowd, k) })) };
}

function groups(count, near) {
  const heads = Array.from({ length: count }, (_, k) => k);
  const head = (k) => { while (heads[k] !== k) k = heads[k]; return k; };
  for (const [one, other] of near) heads[head(other)] = head(one);
  const found = new Map();
  for (let k = 0; k < count; k += 1) found.set(head(k), [...(found.get(head(k)) || []), k]);
  return [...found.values()].filter((members) => members.length > 1);
}

/** Put members on a circle, turned so that they stand as far as possible from all others. */
function fan(at, members, middle, wide) {
  const others = at.filter((place, k) => !members.includes(k) && Math.hypot(place[0] - middle[0], place[1] - middle[1]) < 3 * wide);
  const turned = (turn) => members.map((_, place) => {
    const angle = (2 * Math.PI * (place + turn / TURNS)) / members.length - Math.PI / 2;
    return [middle[0] + wide * Math.cos(angle), middle[1] + wide * Math.sin(angle)];
  });
  let [best, most] = [turned(0), -Infinity];
  for (let turn = 0; turn < (others.length ? TURNS : 1); turn += 1) {
    const places = turned(turn);
    const room = Math.min(...places.flatMap(([x, y]) => others.map((other) => Math.hypot(other[0] - x, other[1] - y))), Infinity);
    if (room > most + 0.5) [best, most] = [places, room];
  }
  members.forEach((k, place) => { at[k] = best[place]; });
}

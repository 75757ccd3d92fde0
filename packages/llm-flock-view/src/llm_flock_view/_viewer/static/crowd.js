// Robots in one place of the picture: where their disks are drawn so that all are seen, and which pairs are too near.
import { links } from "llm-flock-viewer/geometry.js";
import { around, placed } from "llm-flock-viewer/labels.js";

const ROUNDING = 1e-6; // units; as the server counts pairs
const COUNT = 13; // pixels between the middle of a crowd and its disks, for the number in it
const APART = 1.6; // radii, and two pixels of rims, from which on one disk leaves the number of another in sight
const TAG = [26, 16]; // pixels of the number of a crowd
const PASSES = 4; // each move may bring a disk near another
const TURNS = 12; // angles that are tried for a crowd among others

/** Pairs nearer than the safe distance; heights count divided by `downwash`. */
export function closePairs(points, safe, downwash = 1) {
  return links(downwash === 1 ? points : points.map(([x, y, z]) => [x, y, z / downwash]), safe - ROUNDING, new Set());
}

/**
 * Where disks are drawn [pixels]: those that hide one another fan out around their middle, the others' numbers stay in sight.
 * In perspective, where a turn of the picture would make such a circle jump, all of them step aside.
 */
export function fanned(pixels, radius, deep = false) {
  const apart = APART * radius + 2;
  const near = links(pixels, apart, new Set());
  if (!near.length) return { at: pixels, crowds: [] };
  const far = ([one, other]) => Math.hypot(pixels[one][0] - pixels[other][0], pixels[one][1] - pixels[other][1]);
  const at = pixels.map((place) => [...place]);
  const crowds = groups(pixels.length, near.filter((pair) => !deep && far(pair) < 0.9 * radius)).map((members) => {
    const middle = [0, 1].map((axis) => members.reduce((sum, k) => sum + pixels[k][axis], 0) / members.length);
    const wide = Math.max(radius + COUNT, (members.length * (radius + 4)) / Math.PI);
    fan(at, members, middle, wide);
    return { members, middle, wide };
  });
  // A little aside: less than a robot's radius, and nothing to be told.
  for (let pass = 0; pass < PASSES; pass += 1) {
    for (const [one, other] of links(at, apart, new Set())) {
      const [dx, dy] = [at[other][0] - at[one][0] || 0.01, at[other][1] - at[one][1]];
      const gap = Math.hypot(dx, dy);
      const by = (apart - gap) / 2 / gap;
      for (const [k, way] of [[one, -by], [other, by]]) [at[k][0], at[k][1]] = [at[k][0] + dx * way, at[k][1] + dy * way];
    }
    for (const { middle } of crowds) {
      at.forEach((place, k) => {
        const [dx, dy] = [place[0] - middle[0], place[1] - middle[1]];
        const gap = Math.hypot(dx, dy) || 1;
        if (gap < radius + COUNT) at[k] = [middle[0] + (dx / gap) * (radius + COUNT), middle[1] + (dy / gap) * (radius + COUNT)];
      });
    }
  }
  // Where other disks leave no room in the middle, the number stands beside the crowd.
  const clear = ({ middle }, k) => at.every((place) => Math.hypot(place[0] - middle[0], place[1] - middle[1]) > radius + COUNT - 3)
    && crowds.every((other, j) => j === k || Math.hypot(other.middle[0] - middle[0], other.middle[1] - middle[1]) > 2 * COUNT);
  return { at, crowds: crowds.map((crowd, k) => ({ ...crowd, counted: clear(crowd, k) })) };
}

/** Tell crowds in which a pair is too near in space from those that only the picture puts in one place. */
export function tooNear(crowds, pairs) {
  for (const crowd of crowds) {
    const members = new Set(crowd.members);
    crowd.near = pairs.some(([one, other]) => members.has(one) && members.has(other));
  }
}

/** Give the number of each crowd its spot, in its middle or beside it, before any word has one; returns their boxes. */
export function spots(crowds, disks, radius, window, corners) {
  const boxes = crowds.filter((crowd) => crowd.counted).map(({ middle }) => around(middle, TAG));
  const rest = crowds.filter((crowd) => !crowd.counted);
  const all = [...disks, ...rest.map(({ middle, wide }) => [...middle, wide + radius])];
  const found = rest.length ? placed(all, all.map((_, k) => (k < disks.length ? null : TAG)), window, [...corners, ...boxes]) : [];
  for (const crowd of crowds) crowd.spot = crowd.counted ? crowd.middle : null;
  rest.forEach((crowd, k) => {
    const offset = found[disks.length + k];
    if (offset) crowd.spot = crowd.middle.map((part, axis) => part + offset[axis]);
  });
  return crowds.filter((crowd) => crowd.spot).map(({ spot }) => around(spot, TAG));
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

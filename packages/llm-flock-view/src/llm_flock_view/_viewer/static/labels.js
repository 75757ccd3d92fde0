// Where letters and numbers stand beside disks: on no disk, on no other word, within the picture; where there is room, on
// no ring and no line either.

const ANGLES = [270, 90, 315, 225, 45, 135, 0, 180].map((angle) => (angle * Math.PI) / 180); // above is looked at first
const STEPS = 3; // distances from the disk that are tried; farther out nobody sees whose word it is
const GAP = 2; // pixels around a word

/**
 * The middle of each word [pixels], or null where there is no room.
 *
 * `disks` are x, y and radius of each, with its rings; `words` are width and height beside each disk, or null;
 * `taken` are boxes to keep free: left, top, right, bottom. `before` are the offsets of a moment ago: words do not jump.
 * `rings` (x, y, radius) and `lines` (two ends each) are crossed only where there is no other room.
 */
export function placed(disks, words, [width, height], taken = [], before = [], { rings = [], lines = [] } = {}) {
  const found = disks.map(() => null);
  const widest = Math.max(1, ...disks.map((disk) => disk[2])) + Math.max(0, ...words.map((word) => (word ? Math.hypot(...word) : 0)));
  const wordy = disks.map((_, k) => k).filter((k) => words[k]);
  const near = disks.map(() => []);
  for (const k of wordy) {
    near[k] = disks.flatMap((disk, other) => (other !== k && Math.hypot(disk[0] - disks[k][0], disk[1] - disks[k][1]) < 2.5 * widest ? [other] : []));
  }
  // Who stands in a crowd has the least choice, and chooses first.
  const order = wordy.sort((a, b) => near[b].length - near[a].length || a - b);
  const boxes = disks.map(() => null);
  for (const k of order) {
    const [x, y, radius] = disks[k];
    const about = around([x, y], [2.5 * widest, 2.5 * widest]);
    const ringsNear = rings.filter((ring) => meet(around(ring, [2 * ring[2], 2 * ring[2]]), about));
    const linesNear = lines.filter((line) => crosses(line, about));
    const clear = (box) => !ringsNear.some((ring) => onRing(box, ring)) && !linesNear.some((line) => crosses(line, box));
    const free = ([dx, dy]) => {
      const box = around([x + dx, y + dy], words[k]);
      if (box[0] < 1 || box[1] < 1 || box[2] > width - 1 || box[3] > height - 1) return null;
      if (taken.some((other) => meet(box, other)) || covers(box, disks[k])) return null;
      return near[k].some((other) => covers(box, disks[other]) || (boxes[other] && meet(box, boxes[other]))) ? null : box;
    };
    for (const offset of [...(before[k] ? [before[k]] : []), ...offsets(radius, words[k])]) {
      const box = free(offset);
      if (!box) continue;
      const best = clear(box);
      if (!best && boxes[k]) continue; // the first that crosses a line is taken where all others do as well
      boxes[k] = box;
      found[k] = offset;
      if (best) break;
    }
  }
  return found;
}

function* offsets(radius, [wide, high]) {
  for (let step = 0; step < STEPS; step += 1) {
    const out = radius + GAP + 1 + 0.4 * step * radius;
    for (const angle of ANGLES) yield [Math.cos(angle) * (out + wide / 2), Math.sin(angle) * (out + high / 2)];
  }
}

export function around([x, y], [wide, high]) {
  return [x - wide / 2, y - high / 2, x + wide / 2, y + high / 2];
}

function meet(a, b) {
  return a[0] < b[2] + GAP && b[0] < a[2] + GAP && a[1] < b[3] + GAP && b[1] < a[3] + GAP;
}

/** Whether the outline of a ring passes through a box: its nearest point is inside, its farthest outside. */
function onRing([left, top, right, bottom], [x, y, radius]) {
  const dx = Math.max(Math.abs(left - x), Math.abs(right - x));
  const dy = Math.max(Math.abs(top - y), Math.abs(bottom - y));
  return covers([left, top, right, bottom], [x, y, radius + 1.5]) && dx * dx + dy * dy > (radius - 1.5) ** 2;
}

/** Whether a line, between two points, meets a box. */
export function crosses([[ax, ay], [bx, by]], [left, top, right, bottom]) {
  let [from, to] = [0, 1];
  for (const [p, d, low, high] of [[ax, bx - ax, left, right], [ay, by - ay, top, bottom]]) {
    if (!d) {
      if (p < low || p > high) return false;
      continue;
    }
    const [one, other] = [(low - p) / d, (high - p) / d];
    from = Math.max(from, Math.min(one, other));
    to = Math.min(to, Math.max(one, other));
  }
  return from <= to;
}

function covers([left, top, right, bottom], [x, y, radius]) {
  const dx = x - Math.max(left, Math.min(right, x));
  const dy = y - Math.max(top, Math.min(bottom, y));
  return dx * dx + dy * dy < radius * radius;
}

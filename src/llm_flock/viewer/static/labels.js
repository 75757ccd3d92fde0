// Where letters and numbers stand beside disks: on no disk, on no other word, within the picture.

const ANGLES = [270, 90, 315, 225, 45, 135, 0, 180].map((angle) => (angle * Math.PI) / 180); // above is looked at first
const STEPS = 3; // distances from the disk that are tried; farther out nobody sees whose word it is
const GAP = 2; // pixels around a word

/**
 * The middle of each word [pixels], or null where there is no room.
 *
 * `disks` are x, y and radius of each, with its rings; `words` are width and height beside each disk, or null;
 * `taken` are boxes to keep free: left, top, right, bottom. `before` are the offsets of a moment ago: words do not jump.
 */
export function placed(disks, words, [width, height], taken = [], before = []) {
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
    const free = ([dx, dy]) => {
      const box = around([x + dx, y + dy], words[k]);
      if (box[0] < 1 || box[1] < 1 || box[2] > width - 1 || box[3] > height - 1) return null;
      if (taken.some((other) => meet(box, other)) || covers(box, disks[k])) return null;
      return near[k].some((other) => covers(box, disks[other]) || (boxes[other] && meet(box, boxes[other]))) ? null : box;
    };
    for (const offset of [...(before[k] ? [before[k]] : []), ...offsets(radius, words[k])]) {
      const box = free(offset);
      if (!box) continue;
      boxes[k] = box;
      found[k] = offset;
      break;
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

function covers([left, top, right, bottom], [x, y, radius]) {
  const dx = x - Math.max(left, Math.min(right, x));
  const dy = y - Math.max(top, Math.min(bottom, y));
  return dx * dx + dy * dy < radius * radius;
}

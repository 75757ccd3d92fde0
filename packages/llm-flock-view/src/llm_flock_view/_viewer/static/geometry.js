// Radio links and buffered Voronoi cells; a grid makes a thousand robots quick.

/** A number for a box: strings would take most of the time of a picture of a thousand robots. */
function box(column, row) {
  return column * 1048576 + row;
}

function grid(points, edge) {
  const boxes = new Map();
  points.forEach(([x, y], k) => {
    const name = box(Math.floor(x / edge), Math.floor(y / edge));
    if (boxes.has(name)) boxes.get(name).push(k);
    else boxes.set(name, [k]);
  });
  return boxes;
}

const MOST_LINKS = 12000;

/** Pairs of robots within range of each other, in all dimensions; at most MOST_LINKS, which cannot be told apart anyway. */
export function links(points, range, silent) {
  const boxes = grid(points, range);
  const pairs = [];
  for (let one = 0; one < points.length && pairs.length < MOST_LINKS; one += 1) {
    if (silent.has(one)) continue;
    const [x, y, z = 0] = points[one];
    const [column, row] = [Math.floor(x / range), Math.floor(y / range)];
    for (let i = column - 1; i <= column + 1; i += 1) {
      for (let j = row - 1; j <= row + 1; j += 1) {
        for (const other of boxes.get(box(i, j)) || []) {
          if (other <= one || silent.has(other)) continue;
          const there = points[other]; // by index: taking it apart would double the time of a picture of a thousand
          if ((there[0] - x) ** 2 + (there[1] - y) ** 2 + (there.length > 2 ? there[2] - z : 0) ** 2 <= range * range) pairs.push([one, other]);
        }
      }
    }
  }
  return pairs;
}

/** For each robot, the corners of its Voronoi cell drawn in by half the safe distance, within the arena. */
export function cells(points, safe, [low, high]) {
  const n = points.length;
  return points.map(([x, y], robot) => {
    let corners = [[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]];
    const order = [];
    for (let other = 0; other < n; other += 1) {
      if (other === robot) continue;
      const far = (points[other][0] - x) ** 2 + (points[other][1] - y) ** 2;
      if (far > 1e-12) order.push([far, other]);
    }
    order.sort((a, b) => a[0] - b[0]);
    for (const [squared, other] of order) {
      const gap = Math.sqrt(squared);
      // A robot farther away than twice the farthest corner cuts nothing off.
      const reach = Math.max(0, ...corners.map(([a, b]) => Math.hypot(a - x, b - y)));
      if (gap - safe > 2 * reach) break;
      const normal = [(points[other][0] - x) / gap, (points[other][1] - y) / gap];
      corners = clipped(corners, normal, normal[0] * x + normal[1] * y + (gap - safe) / 2);
      if (!corners.length) break;
    }
    return corners;
  });
}

function clipped(corners, [nx, ny], limit) {
  const kept = [];
  corners.forEach((corner, k) => {
    const next = corners[(k + 1) % corners.length];
    const here = nx * corner[0] + ny * corner[1] - limit;
    const there = nx * next[0] + ny * next[1] - limit;
    if (here <= 0) kept.push(corner);
    if (here < 0 !== there < 0 && here !== there) {
      const share = here / (here - there);
      kept.push([corner[0] + share * (next[0] - corner[0]), corner[1] + share * (next[1] - corner[1])]);
    }
  });
  return kept;
}

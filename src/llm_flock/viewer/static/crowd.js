// Robots that stand too close: pairs to be shown in red, and where the disks of a crowd are drawn so that all are seen.
import { links } from "llm-flock-viewer/geometry.js";

const ROUNDING = 1e-6; // units; as the server counts pairs

/** Pairs nearer than the safe distance. */
export function closePairs(points, safe) {
  return links(points, safe - ROUNDING, new Set());
}

/** Where disks are drawn [pixels]: those that hide one another fan out around their middle. */
export function fanned(pixels, radius) {
  const near = links(pixels, radius * 0.9, new Set());
  if (!near.length) return { at: pixels, crowds: [] };
  const heads = pixels.map((_, k) => k);
  const head = (k) => { while (heads[k] !== k) k = heads[k]; return k; };
  for (const [one, other] of near) heads[head(other)] = head(one);
  const groups = new Map();
  pixels.forEach((_, k) => {
    const first = head(k);
    groups.set(first, [...(groups.get(first) || []), k]);
  });
  const at = pixels.map((place) => [...place]);
  const crowds = [];
  for (const members of groups.values()) {
    if (members.length < 2) continue;
    const middle = [0, 1].map((axis) => members.reduce((sum, k) => sum + pixels[k][axis], 0) / members.length);
    const wide = Math.max(radius + 8, (members.length * radius * 2.1) / (2 * Math.PI));
    members.forEach((k, place) => {
      const angle = (2 * Math.PI * place) / members.length - Math.PI / 2;
      at[k] = [middle[0] + wide * Math.cos(angle), middle[1] + wide * Math.sin(angle)];
    });
    crowds.push({ members, middle });
  }
  return { at, crowds };
}

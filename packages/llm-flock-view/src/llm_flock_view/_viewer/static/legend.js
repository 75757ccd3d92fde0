// What the signs of an arena mean.
import { button, h, picture } from "llm-flock-viewer/dom.js";

const disk = (more = {}) => ["circle", { cx: 14, cy: 12, r: 7, class: "k-fill k-ink", ...more }];
const number = (text, about = {}) => ["text", { x: 14, y: 15.5, class: "k-text", text, ...about }];

// Each with the layer that shows it, where it is not always there.
const SIGNS = [
  [[disk(), number("3")], "robot, in its plan's colour"],
  [[["rect", { x: 7, y: 5, width: 14, height: 14, class: "k-fill" }], number("A")], "letter of its plan", "plans"],
  [[["rect", { x: 3, y: 2, width: 22, height: 19, rx: 9, class: "k-area" }], disk({ cx: 9, r: 4 }), disk({ cx: 19, r: 4 })], "area: robots of one plan, with its letter once", "crowd"],
  [[disk({ class: "k-fill k-ink k-dashes" }), number("3")], "dashed rim: another plan, its colour used again", "repeated"],
  [[["circle", { cx: 14, cy: 12, r: 7, class: "k-none k-ink k-dots" }], number("3", { class: "k-text k-plain" })], "robot without a plan"],
  [[["circle", { cx: 14, cy: 12, r: 8, class: "k-none k-line" }]], "ring: its goal", "goals"],
  [[disk({ r: 5 }), ["circle", { cx: 14, cy: 11, r: 8, class: "k-none k-edge" }],
    ["circle", { cx: 14, cy: 11, r: 8, class: "k-none k-bent" }]], "not moved as its model wanted"],
  [[disk(), ["rect", { x: 17, y: 1, width: 9, height: 9, class: "k-warn" }],
    ["text", { x: 21.5, y: 8.5, class: "k-text k-small", text: "!" }]], "its model is not asked (breaker)"],
  [[["circle", { cx: 9, cy: 12, r: 5, class: "k-fill k-danger" }], ["circle", { cx: 19, cy: 12, r: 5, class: "k-fill k-danger" }],
    ["line", { x1: 9, y1: 12, x2: 19, y2: 12, class: "k-danger" }]], "nearer than the safe distance"],
  [[["rect", { x: 4, y: 5, width: 20, height: 14, class: "k-count" }], number("2×", { class: "k-text k-onred" })], "hide one another: too near"],
  [[["rect", { x: 4, y: 5, width: 20, height: 14, class: "k-many" }], number("2×", { class: "k-text k-onred" })], "hide one another, as one above the other: not too near"],
  [[["circle", { cx: 9, cy: 12, r: 7, class: "k-dead" }], number("×", { x: 9, y: 16, class: "k-text k-paper" }),
    number("3", { x: 23, class: "k-text k-plain" })], "dead, with its number"],
  [[["circle", { cx: 14, cy: 12, r: 7, class: "k-asleep k-ink k-dots" }], number("3", { class: "k-text k-onfaint" })], "has not begun yet"],
  [[disk({ cx: 8, cy: 6, r: 4 }), ["line", { x1: 8, y1: 6, x2: 8, y2: 21, class: "k-thin" }], number("↕9", { x: 20, class: "k-text k-plain" })], "height [units]; line down to the ground", "space"],
  [[["circle", { cx: 14, cy: 11, r: 9, class: "k-none k-chosen" }], disk({ cy: 11, r: 5 })], "chosen robot"],
  [[["line", { x1: 2, y1: 12, x2: 26, y2: 12, class: "k-thin" }]], "radio link", "links"],
  [[["path", { d: "M2 17 Q12 17 16 10 T26 6", class: "k-trail" }]], "its way, last 24 rounds", "trails"],
  [[["line", { x1: 2, y1: 12, x2: 26, y2: 12, class: "k-way" }]], "from chosen robot to goal", "goals"],
  [[["rect", { x: 4, y: 4, width: 20, height: 15, class: "k-none k-thin" }], ["rect", { x: 11, y: 8, width: 8, height: 7, class: "k-asleep" }]], "walls; grey: obstacle"],
  [[number("0.25", { class: "k-text k-plain" })], "influence: share of the team that hears it", "influence"],
  [[disk({ r: 4 }), ["circle", { cx: 14, cy: 12, r: 9, class: "k-none k-safety" }]], "safety disc: two that touch are too close", "safety"],
  [[["path", { d: "M5 8 L16 3 L25 12 L15 20 Z", class: "k-cell" }]], "cell that it may fly in, safe from the others", "cells"],
];

const ROOM = "(min-width: 1100px)"; // windows with room for the legend beside the arena

/** A legend of the layers that are on, and the button that folds it. In wide windows it stays as the reader left it. */
export function legend(open, layers) {
  const room = matchMedia(ROOM);
  const stored = () => { try { return localStorage.getItem("flock-legend"); } catch { return null; } };
  const element = h("section", { class: "flock-legend", id: "flock-legend", "aria-label": "Legend", tabindex: "0" },
    h("ul", {}, ...SIGNS.map(([parts, text, layer]) => h("li", { "data-layer": layer || "", hidden: Boolean(layer && !layers[layer]) },
      picture(28, 22, parts), h("span", { text })))));
  const act = button("Legend", () => turn(element.hidden), { words: "Legend (L)" });
  act.setAttribute("aria-controls", element.id);
  const turn = (now) => {
    element.hidden = !now;
    act.setAttribute("aria-expanded", String(now));
  };
  const fit = () => turn(room.matches && (stored() === null ? open && matchMedia("(min-width: 1500px)").matches : stored() === "1"));
  fit();
  room.addEventListener("change", fit);
  act.addEventListener("click", () => {
    if (!room.matches) return;
    try { localStorage.setItem("flock-legend", element.hidden ? "0" : "1"); } catch { /* nothing is kept */ }
  });
  /** A sign is there while its layer is, or what it stands for. */
  const show = (name, on) => {
    for (const line of element.querySelectorAll(`[data-layer="${name}"]`)) line.hidden = !on;
  };
  return { element, act, show };
}

// What the signs of an arena mean.
import { button, h, picture } from "llm-flock-viewer/dom.js";

const disk = (more = {}) => ["circle", { cx: 14, cy: 12, r: 7, class: "k-fill k-ink", ...more }];
const number = (text, about = {}) => ["text", { x: 14, y: 15.5, class: "k-text", text, ...about }];

const SIGNS = [
  [[disk(), number("3")], "robot, in its plan's colour"],
  [[["rect", { x: 7, y: 5, width: 14, height: 14, class: "k-fill" }], number("A")], "letter of its plan"],
  [[["circle", { cx: 14, cy: 12, r: 7, class: "k-none k-ink k-dots" }], number("3", { class: "k-text k-plain" })], "robot without a plan"],
  [[["circle", { cx: 14, cy: 12, r: 8, class: "k-none k-line" }]], "ring: its goal"],
  [[disk({ r: 6 }), ["circle", { cx: 14, cy: 12, r: 9.5, class: "k-none k-edge" }],
    ["circle", { cx: 14, cy: 12, r: 9.5, class: "k-none k-bent" }]], "not moved as its model wanted"],
  [[disk(), ["rect", { x: 17, y: 1, width: 9, height: 9, class: "k-warn" }],
    ["text", { x: 21.5, y: 8.5, class: "k-text k-small", text: "G" }]], "its model is not asked (breaker)"],
  [[["circle", { cx: 9, cy: 12, r: 5, class: "k-fill k-danger" }], ["circle", { cx: 19, cy: 12, r: 5, class: "k-fill k-danger" }],
    ["line", { x1: 9, y1: 12, x2: 19, y2: 12, class: "k-danger" }]], "nearer than the safe distance"],
  [[["circle", { cx: 14, cy: 12, r: 7, class: "k-dead" }], number("×", { class: "k-text k-paper" })], "dead; grey: not begun yet"],
  [[["circle", { cx: 14, cy: 12, r: 9, class: "k-none k-chosen" }], disk({ r: 5 })], "chosen robot"],
  [[["line", { x1: 2, y1: 12, x2: 26, y2: 12, class: "k-thin" }]], "radio link"],
  [[["path", { d: "M2 17 Q12 17 16 10 T26 6", class: "k-trail" }]], "its way, last 24 rounds"],
  [[["line", { x1: 2, y1: 12, x2: 26, y2: 12, class: "k-way" }]], "from chosen robot to goal"],
];

/** A legend and the button that folds it; it stays as the reader left it. */
export function legend(open) {
  const stored = () => { try { return localStorage.getItem("flock-legend"); } catch { return null; } };
  const kept = stored();
  const element = h("section", { class: "flock-legend", id: "flock-legend", "aria-label": "Legend", tabindex: "0" },
    h("ul", {}, ...SIGNS.map(([parts, text]) => h("li", {}, picture(28, 22, parts), h("span", { text })))));
  const act = button("Legend", () => turn(element.hidden), { words: "Legend (L)" });
  act.setAttribute("aria-controls", element.id);
  const turn = (now) => {
    element.hidden = !now;
    act.setAttribute("aria-expanded", String(now));
  };
  turn(kept === null ? open : kept === "1");
  act.addEventListener("click", () => {
    try { localStorage.setItem("flock-legend", element.hidden ? "0" : "1"); } catch { /* nothing is kept */ }
  });
  return { element, act };
}

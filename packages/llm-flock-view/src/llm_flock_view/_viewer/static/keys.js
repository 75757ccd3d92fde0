// The keys of a page, and the dialog that lists them.
import { dialog, h } from "llm-flock-viewer/dom.js";

const KEYS = [
  ["Space", "play or pause the picture (a run in flight goes on)"],
  ["← →", "one round back, one round on"],
  ["Home, End", "to the start; to the end, and follow a run in flight"],
  ["[ ]", "the robot before, the next robot"],
  ["+ −", "zoom in, zoom out"],
  ["F", "show the formation of the last round"],
  ["0", "show the whole way of the team"],
  ["A", "show the whole arena"],
  ["Shift and arrows", "move the picture"],
  ["V, T, S", "see space in perspective, from above, from the side"],
  [", . ; :", "turn space left, right, down, up"],
  ["L", "show or hide the legend"],
  ["Tab", "to the next control"],
  ["Escape", "close what is open over the page"],
  ["?", "this list"],
];

/** List the keys. */
export function showKeys() {
  if (document.querySelector("dialog[open]")) return;
  dialog("Keys", h("table", { class: "flock-table" }, h("tbody", {},
    ...KEYS.map(([key, what]) => h("tr", {}, h("th", { scope: "row" }, h("kbd", { text: key })), h("td", { text: what }))))));
}

/** Keys of a whole page by name, except where a control that takes keys of its own has the focus. */
export function listenToKeys(acts) {
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented) return;
    if (event.target.closest("input:not([type=checkbox]), textarea, select, [role=tab], dialog[open]")) return;
    if (event.key === " " && event.target.closest("button, a, summary, input")) return;
    const act = acts[event.shiftKey && event.key.startsWith("Arrow") ? `Shift${event.key}` : event.key];
    if (!act) return;
    act();
    event.preventDefault();
  });
}

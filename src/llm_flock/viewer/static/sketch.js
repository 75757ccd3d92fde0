// The first look at a run: its arena and time line, until the page around them is there and draws them itself.
import { build, clock } from "llm-flock-viewer";

const KEPT = "flock-round";

/** Draw the parts of the sketch, and leave when the page has drawn its own. */
export function sketch() {
  const cover = document.getElementById("flock-sketch");
  if (matchMedia("(prefers-color-scheme: dark)").matches) document.body.classList.add("body--dark");
  const time = clock("main");
  time.cursor = Number(sessionStorage.getItem(KEPT) || 0);
  time.held = time.cursor > 0;
  sessionStorage.removeItem(KEPT);
  const places = cover.querySelectorAll(".flock-part");
  const parts = JSON.parse(cover.querySelector("script").textContent)
    .map(([kind, options], k) => build(kind, places[k], options, () => {}));
  const leave = () => {
    const own = document.querySelector("#app .flock-arena canvas");
    // Where there is nothing to draw, the page says why as well as the sketch does.
    if (!own || (cover.querySelector("canvas[data-round]") && !own.dataset.round)) {
      requestAnimationFrame(leave);
      return;
    }
    for (const part of parts) part.close();
    cover.remove();
  };
  leave();
}

/** Remember the round over a new loading of the page. */
export function keep() {
  const time = clock("main");
  const round = Math.floor(time.cursor);
  if (round && !time.following) sessionStorage.setItem(KEPT, String(round));
}

// The first look at a run: its arena and timeline, until the page around them has loaded and draws its own.
import { build, clock } from "llm-flock-viewer";

const SAVED = "flock-round";

/** Draw the canvases of the preview, and remove them when the page has drawn its own. */
export function preview() {
  const cover = document.getElementById("flock-preview");
  if (matchMedia("(prefers-color-scheme: dark)").matches) document.body.classList.add("body--dark");
  const time = clock("main");
  time.cursor = Number(sessionStorage.getItem(SAVED) || 0);
  time.held = time.cursor > 0;
  sessionStorage.removeItem(SAVED);
  const places = cover.querySelectorAll(".flock-part");
  const canvases = JSON.parse(cover.querySelector("script").textContent)
    .map(([kind, options], k) => build(kind, places[k], options, () => {}));
  const leave = () => {
    const own = document.querySelector("#app .flock-arena canvas");
    // Where there is nothing to draw, the page says why, as the preview does.
    if (!own || (cover.querySelector("canvas[data-round]") && !own.dataset.round)) {
      requestAnimationFrame(leave);
      return;
    }
    for (const canvas of canvases) canvas.close();
    cover.remove();
  };
  leave();
}

/** Keep the round while the page reloads. */
export function saveRound() {
  const time = clock("main");
  const round = Math.floor(time.cursor);
  if (round && !time.following) sessionStorage.setItem(SAVED, String(round));
}

// Buttons under the arena: they move the picture, never the run.
import { button, choice, h } from "llm-flock-viewer/dom.js";
import { stateAt } from "llm-flock-viewer/banner.js";

const SPEEDS = [0.5, 1, 2, 4, 10, 30, 100];

/** Play, step, speed, where the cursor is, and the state of each run there. */
export function transport(runs, names, clock) {
  const play = button("▶", () => clock.toggle(), { words: "Play the picture (space)" });
  const speed = choice(SPEEDS.map((value) => [value, `${value} / s`]), clock.speed, (value) => { clock.speed = Number(value); });
  speed.setAttribute("aria-label", "Rounds a second of the picture");
  speed.title = "Rounds a second of the picture";
  const where = h("output", { class: "flock-where", text: "round 0" });
  const simulated = h("span", { class: "flock-badge", text: "simulated language models", hidden: true });
  const states = runs.map(() => h("span", { class: "flock-badge flock-state" }));
  const refresh = () => {
    const moving = clock.playing || clock.following;
    const words = moving ? "Pause the picture (space)" : "Play the picture (space)";
    set(play, "textContent", moving ? "❚❚" : "▶");
    if (play.title !== words) {
      play.title = words;
      play.setAttribute("aria-label", words);
    }
    set(where, "textContent", `round ${clock.round} of ${clock.last}`);
    simulated.hidden = !runs.some((run) => run.about && run.about.simulated);
    states.forEach((made, k) => {
      const text = state(runs[k], clock);
      set(made, "textContent", names.length > 1 ? `${names[k]}: ${text}` : text);
      made.dataset.tone = clock.following ? "live" : "plain";
    });
  };
  clock.listen(refresh);
  return h("div", { class: "flock-transport" },
    button("|◀", () => clock.seek(0), { words: "To the start (Home)" }),
    button("−1", () => clock.step(-1), { words: "One round back (left arrow)" }), play,
    button("+1", () => clock.step(1), { words: "One round on (right arrow)" }),
    button("▶|", () => clock.live(), { words: "To the end (End)" }), speed, where, simulated, ...states);
}

function set(element, name, value) {
  if (element[name] !== value) element[name] = value;
}

function state(run, clock) {
  if (run.failure && !run.about) return run.failure;
  const now = stateAt(run, Math.min(clock.round, Math.max(0, run.last)));
  if (!run.open) return now;
  if (!run.about || !run.about.live) return "reading …";
  const held = run.steer && run.steer.paused ? "the run is held" : clock.following ? "live" : "still running";
  return now ? `${held} · ${now}` : held;
}

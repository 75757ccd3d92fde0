// The drawn parts of the viewer. Everything that comes from a run is drawn or set as text, never as markup.
import { Clock } from "llm-flock-viewer/clock.js";
import { Reel } from "llm-flock-viewer/reel.js";
import { Arena } from "llm-flock-viewer/arena.js";
import { Timeline } from "llm-flock-viewer/timeline.js";
import { Plots } from "llm-flock-viewer/plots.js";

const KINDS = { arena: Arena, timeline: Timeline, plots: Plots };
const clocks = new Map();
const reels = new Map();

/** The clock that parts of one page share. */
export function clock(name) {
  if (!clocks.has(name)) clocks.set(name, new Clock());
  return clocks.get(name);
}

/** A run, fetched once for all parts of the page that show it. */
export function reel(key, clockName) {
  if (!reels.has(key)) {
    const found = new Reel(key);
    reels.set(key, found);
    clock(clockName).attach(found);
  }
  return reels.get(key);
}

globalThis.flockClock = clock;

/** Build a part inside an element. */
export function build(kind, element, options, emit) {
  const time = clock(options.clock);
  const runs = options.keys.map((key) => reel(key, options.clock));
  return new KINDS[kind](element, runs, time, options, emit);
}

// The canvases of the viewer. Everything that comes from a run is drawn or set as text, never as markup.
import { Clock } from "llm-flock-viewer/clock.js";
import { Recording } from "llm-flock-viewer/recording.js";
import { Arena } from "llm-flock-viewer/arena.js";
import { Timeline } from "llm-flock-viewer/timeline.js";
import { Plots } from "llm-flock-viewer/plots.js";

const KINDS = { arena: Arena, timeline: Timeline, plots: Plots };
const clocks = new Map();
const recordings = new Map();

/** The clock that the canvases of one page share. */
export function clock(name) {
  if (!clocks.has(name)) clocks.set(name, new Clock());
  return clocks.get(name);
}

/** A run, fetched once for all canvases that show it. */
export function recording(key, clockName) {
  if (!recordings.has(key)) {
    const run = new Recording(key);
    recordings.set(key, run);
    clock(clockName).attach(run);
  }
  return recordings.get(key);
}

globalThis.flockClock = clock;

/** Build a canvas inside an element. */
export function build(kind, element, options, emit) {
  const time = clock(options.clock);
  const found = options.keys.map((key) => recording(key, options.clock));
  return new KINDS[kind](element, found, time, options, emit);
}

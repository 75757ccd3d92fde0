// Builds the page that its options name.
import { player } from "llm-flock-viewer/player.js";

const options = JSON.parse(document.getElementById("flock-options").textContent);
const place = document.getElementById("flock");

async function unpack(text) {
  const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).json();
}

/** What the viewer's server answers, from the page itself. */
function answers(run) {
  return async (path) => {
    const [what, query] = path.split("?");
    if (what === "about") return run.about;
    if (what === "news") return run.news;
    const asked = new URLSearchParams(query);
    const words = (asked.get("find") || "").toLowerCase().split(/\s+/).filter(Boolean);
    if (what === "events" && words.length) {
      const lines = run.events.flatMap(({ round, lines: all }) => all.map((line) => [...line, round]))
        .map((line) => [line, `${line[0]} ${line[1]}`.toLowerCase()]) // a number is meant as a whole
        .filter(([, text]) => words.every((word) => (/^\d+$/.test(word) ? text.split(/[\s,()]+/) : text).includes(word))).map(([line]) => line);
      return { round: null, more: lines.length > 100, lines: lines.slice(0, 100) };
    }
    if (what === "events") return run.events[Number(asked.get("round"))] || null;
    const first = Number(asked.get("first"));
    return run.frames.slice(first, first + Number(asked.get("count")));
  };
}

async function start() {
  const held = document.getElementById("flock-run");
  if (!held) {
    (globalThis.flockPages[options.page] || player)(options, place);
    return;
  }
  try {
    player(options, place, answers(await unpack(held.textContent)));
  } catch (error) {
    place.textContent = `This browser cannot show the run (${error.message}). It needs DecompressionStream.`;
  }
}

start();

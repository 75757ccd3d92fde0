// The pages that a replay does not need.
import { h, header } from "llm-flock-viewer/dom.js";
import { cockpit } from "llm-flock-viewer/cockpit.js";
import { runs } from "llm-flock-viewer/runs.js";

/** At an address without a run. */
function lost(options, place) {
  place.replaceChildren(header(options.title, [["Runs", "/runs"], ["Cockpit", "/cockpit"]], []),
    h("main", { class: "flock-page" }, h("section", { class: "flock-card" }, h("h2", { class: "flock-subtitle", text: options.title }),
      h("p", { text: "Its record was deleted, or lies in a folder that this viewer does not show." }), h("a", { href: "/runs", text: "All runs" }))));
}

globalThis.flockPages = { cockpit, runs, lost };

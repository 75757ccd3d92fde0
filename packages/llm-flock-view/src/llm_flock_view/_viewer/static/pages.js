// The pages that a replay does not need.
import { cockpit } from "llm-flock-viewer/cockpit.js";
import { runs } from "llm-flock-viewer/runs.js";

globalThis.flockPages = { cockpit, runs };

// What came of a run, in words above its arena: which protocol, whether and when it formed, and who kept it from that.
import { h } from "llm-flock-viewer/dom.js";
import { side } from "llm-flock-viewer/surface.js";

/** Of each tone; "part" is a team that formed, but does not stand whole now. */
export const SIGNS = { good: "✓", part: "◐", bad: "✗", open: "…" };

/** The mission in force in a round: its number, how many there are, and its part of the run. */
export function missionAt(run, round) {
  const parts = run.outcome ? run.outcome.missions : [];
  let k = 0;
  parts.forEach((part, number) => { if (part.first <= round) k = number; });
  return { number: k + 1, of: parts.length, part: parts[k] || null };
}

/** Whether the team stands formed in a round, or did before in its mission, in words. */
export function stateAt(run, round) {
  const { number, of, part } = missionAt(run, round);
  if (!part) return run.failure || "";
  const which = of > 1 ? `mission ${number} of ${of} (${part.text}): ` : "";
  const { values } = run.figures.in_order_since;
  const told = part.formed !== null && round >= part.formed;
  // Older records do not say in which rounds the team was in order.
  if (told && Number.isNaN(values[part.formed])) return `${which}formed in round ${part.formed}`;
  let last = round;
  // Three rounds in order on end count, or what the result of a swarm calls formed.
  while (last >= part.first && values[values[last] + 2] !== values[last] && values[last] !== part.formed) last -= 1;
  if (last < part.first) return `${which}not formed${run.open || round < run.last ? " yet" : ""}`;
  return `${which}formed in round${last === round ? ` ${values[last]}` : `s ${values[last]} to ${last}, not now`}`;
}

/** Which line of a plot is whose, and why it ends where it does. */
export class Ends {
  constructor(runs, names, clock) {
    this.lines = runs.map((run, k) => ({ run, name: names[k], key: h("span", { class: "flock-key", "aria-hidden": "true" }), text: h("span", {}) }));
    this.element = h("ul", { class: "flock-ends" }, ...this.lines.map((one) => h("li", {}, one.key, one.text)));
    clock.listen(() => this.draw());
  }

  draw() {
    const key = this.lines.map(({ run }) => `${run.open} ${run.last} ${run.outcome && run.outcome.headline}`).join();
    if (key === this.key) return;
    this.key = key;
    this.lines.forEach(({ run, name, key, text }, k) => {
      key.style.borderTop = strokeOf(k);
      const found = run.outcome;
      const end = !found || run.open ? "goes on" : `${found.headline.toLowerCase()}; the run ends in round ${run.last}`;
      text.textContent = `${name}: ${end}`;
    });
  }
}

function strokeOf(k) {
  return `3px ${side(k).stroke.length ? "dashed" : "solid"} ${side(k).ink}`;
}

export class Banner {
  constructor(run, k, pair, clock, choose) {
    Object.assign(this, { run, k, pair, clock, choose, text: "" });
    this.sign = h("span", { class: "flock-sign", "aria-hidden": "true" });
    this.headline = h("strong", { class: "flock-headline" });
    this.protocol = h("span", { class: "flock-chip" });
    this.missions = h("ol", { class: "flock-missions" });
    this.why = h("div", { class: "flock-why" });
    this.more = h("button", { type: "button", class: "flock-link flock-more", text: "More", "aria-expanded": "false",
      onclick: () => { this.more.ariaExpanded = String(this.more.ariaExpanded !== "true"); } });
    this.key = pair ? h("span", { class: `flock-key flock-side-${k}`, "aria-hidden": "true" }) : null;
    this.element = h("div", { class: "flock-banner", role: "status" },
      h("div", { class: "flock-said-first" }, this.key, h("span", {}, this.sign, " ", this.headline), this.protocol, this.more), this.missions, this.why);
    clock.listen(() => this.draw());
  }

  draw() {
    if (this.key) this.key.style.borderTop = strokeOf(this.k);
    const { run } = this;
    const round = Math.min(this.clock.round, Math.max(0, run.last));
    const now = run.outcome ? missionAt(run, round).number : 0;
    if (run.outcome === this.seen && run.failure === this.failed && now === this.shown) return;
    [this.seen, this.failed, this.shown] = [run.outcome, run.failure, now];
    const text = JSON.stringify([run.outcome, run.failure, now, run.open]);
    if (text === this.text) return; // screen readers hear what changed, not every round
    this.text = text;
    const found = run.outcome;
    this.element.dataset.tone = found ? found.tone : "open";
    this.sign.textContent = found ? SIGNS[found.tone] : "";
    this.headline.textContent = found ? found.headline : run.failure || "Starting: waiting for the first round …";
    this.protocol.textContent = found && found.protocol ? [`protocol: ${found.protocol}`, found.missions.length === 1 ? found.missions[0].text : ""].filter(Boolean).join(" · ") : "";
    const parts = found ? found.missions : [];
    this.missions.replaceChildren(...(parts.length > 1 ? parts : []).map((part, k) => h("li", {
      class: k + 1 === now ? "flock-now" : "", "aria-current": k + 1 === now ? "step" : null,
      text: `${k + 1}. ${part.text}${part.first ? ` (from round ${part.first})` : ""}: ${
        part.formed === null ? (part.last === null && run.open ? "not formed yet" : "not formed") : `formed in round ${part.formed}`}`,
    })));
    this.why.replaceChildren(...this.words(found));
  }

  words(found) {
    if (!found) return [];
    if (this.run.failure) return [h("span", { text: this.run.failure })];
    if (!found.why) return found.by ? [h("span", { class: "flock-hint", text: found.by })] : [];
    const robots = found.robots.slice(0, 4).map((robot, k) => h("button", { type: "button", class: "flock-link",
      text: k ? String(robot) : `Show robot ${robot}`, "aria-label": `Show robot ${robot}`, onclick: () => this.choose(robot) }));
    return [h("span", { text: `Why: ${found.why} ` }), ...robots];
  }
}

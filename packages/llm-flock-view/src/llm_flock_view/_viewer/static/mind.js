// What a robot knew and asked in a round, and the events of the round: text that follows the cursor.
import { button, choice, field, fill, h } from "llm-flock-viewer/dom.js";

const GONE = "The viewer does not answer: is its command still running?";
const MANY = 30; // robots from which on one is searched by its number
const REFRESH_MS = 400; // while the cursor runs, text follows more slowly than the picture

/** Calls `show` with the round under the cursor, at once when it stands and seldom while it runs. */
export function following(clock, show) {
  let [shown, due] = [null, 0];
  const look = () => {
    const round = clock.round;
    if (round === shown) return;
    const now = performance.now();
    if ((clock.playing || clock.following) && now < due) {
      setTimeout(look, due - now + 5);
      due = Math.max(due, now);
      return;
    }
    due = now + REFRESH_MS;
    shown = round;
    show(round);
  };
  clock.listen(look);
  return () => { shown = null; look(); };
}

export class Minds {
  constructor(runs, names, clock, select) {
    this.runs = runs;
    this.names = names;
    this.clock = clock;
    this.tell = select;
    this.lists = ["Robot", "Compare with"].map((label, k) => {
      const list = choice([["", "none"]], "", () => this.changed());
      list.id = `flock-robot-${k}`;
      return list;
    });
    this.note = h("div", { class: "flock-hint flock-first" });
    this.brief = h("button", { type: "button", class: "flock-brief", hidden: true });
    this.find = field("Find a robot", h("input", { type: "number", min: 0, placeholder: "number", onchange: () => this.search() }));
    this.find.box.classList.add("flock-find");
    this.find.box.hidden = true; // a list of few is read
    this.place = h("div", { class: "flock-minds" });
    this.element = h("div", {}, h("div", { class: "flock-choose" }, ...this.lists.map((list, k) =>
      h("div", { class: "flock-labelled" }, h("label", { for: list.id, text: ["Robot", "Compare with"][k] }), list))),
    this.find.box, this.note, this.place);
    this.sizes = "";
    this.asked = 0;
    this.opened = false;
    this.unfolded = new Set(); // calls whose prompts are shown: the same ones in other rounds, and of other robots
    clock.listen(() => this.offer());
    this.refresh = following(clock, (round) => this.show(round));
  }

  /** Fill the lists once the teams are known, and open with the robot that is worth a look. */
  offer() {
    const sizes = this.runs.map((run) => (run.about ? run.about.robots : 0));
    if (String(sizes) !== this.sizes) {
      this.sizes = String(sizes);
      this.find.box.hidden = Math.max(...sizes) <= MANY;
      const robots = sizes.flatMap((n, k) => Array.from({ length: n }, (_, robot) =>
        [`${k}:${robot}`, sizes.length > 1 ? `${this.names[k]}: ${robot}` : String(robot)]));
      for (const list of this.lists) fill(list, [["", "none"], ...robots], list.value);
    }
    const k = Math.max(0, this.runs.findIndex((run) => run.outcome && run.outcome.robots.length));
    const found = this.runs[k].outcome;
    if (!this.opened && found && !this.runs.some((run) => run.open && !(run.about && run.about.live))) {
      this.opened = true;
      if (this.lists[0].value) return;
      this.choose(k, found.interesting.robot, false);
      this.note.textContent = `Robot ${found.interesting.robot} is shown first: ${found.interesting.why}.`;
    }
  }

  search() {
    const { value } = this.find.control;
    const known = value !== "" && [...this.lists[0].options].some((one) => one.value === `0:${Number(value)}`);
    this.find.say(known || value === "" ? "" : `The team has robots 0 to ${this.runs[0].about.robots - 1}`);
    if (known) this.choose(0, Number(value), false);
  }

  choose(k, robot, second) {
    const list = this.lists[second && this.lists[0].value ? 1 : 0];
    list.value = `${k}:${robot}`;
    this.changed();
  }

  changed() {
    this.note.textContent = "";
    this.opened = true;
    // A robot is not compared with itself.
    const [first, second] = this.lists;
    if (second.value === first.value) second.value = "";
    for (const option of second.options) option.disabled = Boolean(option.value) && option.value === first.value;
    const chosen = this.chosen();
    this.runs.forEach((_, k) => this.tell(k, chosen.filter((one) => one[0] === k).map((one) => one[1])));
    this.refresh();
  }

  chosen() {
    return this.lists.map((list) => list.value).filter(Boolean).map((value) => value.split(":").map(Number));
  }

  async show(round) {
    const mine = (this.asked += 1);
    const chosen = this.chosen();
    const told = (text) => this.place.replaceChildren(h("div", { class: "flock-hint", text }));
    if (chosen.length && !this.place.querySelector("article")) told("Reading …");
    let gone = false;
    const found = await Promise.all(chosen.map(async ([k, robot]) => {
      try {
        return round <= this.runs[k].last ? await this.runs[k].get(`mind?robot=${robot}&round=${round}`) : null;
      } catch {
        gone = true;
        return null;
      }
    }));
    if (mine !== this.asked) return;
    const minds = found.map((mind, number) => mind && this.mind(this.runs[chosen[number][0]], mind)).filter(Boolean);
    const [first] = found;
    const last = first && first.calls.at(-1);
    this.brief.hidden = !first;
    const said = () => (last ? `${last.used ? "✓" : "✗"} ${last.answer === null ? last.verdict : `“${last.answer}”`}` : unasked(first));
    if (first) this.brief.textContent = `Robot ${first.robot} in round ${first.round}: ${said()}`;
    const over = chosen.some(([k]) => round > this.runs[k].last) ? "This run ended before the round under the cursor." : "";
    if (minds.length) this.place.replaceChildren(...minds);
    else told(gone ? GONE : over || (chosen.length && "Reading …") || "Choose a robot: click on it, or choose its number. Shift-click a second one to compare.");
  }

  mind(run, found) {
    return h("article", { class: "flock-mind" },
      h("h2", { class: "flock-subtitle", text: `Robot ${found.robot} · round ${found.round}` }),
      h("div", { class: "flock-facts", text: found.facts }),
      ...found.breakers.map((text) => h("div", { class: "flock-said flock-warned", text })),
      ...(found.calls.length ? found.calls.map((call, k) => this.call(run, found, call, k)) : this.silent(found)),
      ...(found.provenance ? [h("h3", { class: "flock-role", text: "Provenance of its plan" }), h("div", { class: "flock-facts", text: found.provenance })] : []),
      h("h3", { class: "flock-role", text: `Claims within its radio range (${found.n_claims})` }),
      h("table", { class: "flock-table" },
        h("thead", {}, h("tr", {}, ...["robot", "plan", "place", "influence", "distance [units]"].map((text) => h("th", { scope: "col", text })))),
        h("tbody", {}, ...found.claims.map((row) => h("tr", {}, ...row.map((text) => h("td", { text })))))));
  }

  silent(found) {
    const told = h("div", { class: "flock-hint", text: unasked(found) });
    return found.before === null ? [told] : [told, button(`Go to round ${found.before}`, () => this.clock.seek(found.before))];
  }

  call(run, found, call, k) {
    const prompt = h("details", { class: "flock-prompt" }, h("summary", { text: `Prompt (${call.messages} ${call.messages === 1 ? "message" : "messages"})` }));
    prompt.open = this.unfolded.has(k);
    // Conversations are long: they are sent when they are opened.
    prompt.addEventListener("toggle", async () => {
      this.unfolded[prompt.open ? "add" : "delete"](k);
      if (!prompt.open || prompt.childNodes.length > 1) return;
      const said = await run.get(`prompt?robot=${found.robot}&round=${found.round}&call=${k}`);
      for (const [role, text] of said) prompt.append(h("div", { class: "flock-role", text: role }), h("div", { class: "flock-said", text }));
    });
    return h("section", { class: "flock-call" },
      h("h3", { class: "flock-call-title", text: call.title }), h("div", { class: "flock-hint", text: call.model }), prompt,
      ...(call.answer === null ? [] : [h("div", { class: "flock-role", text: "answer" }),
        h("div", { class: "flock-said flock-answer", tabindex: "0", text: call.answer })]),
      h("div", { class: call.used ? "flock-verdict" : "flock-verdict flock-bad" },
        h("span", { "aria-hidden": "true", text: call.used ? "✓" : "✗" }), h("span", { class: "flock-said", text: call.verdict })),
      h("div", { class: "flock-hint", text: call.price }));
  }
}

function unasked({ before }) {
  return before === null ? "Its model has not been asked yet." : `Its model was last asked in round ${before}.`;
}

/** The events of the round under the cursor, as sentences. */
export class Events {
  constructor(runs, names, clock) {
    this.runs = runs;
    this.names = names;
    this.clock = clock;
    this.asked = 0;
    this.list = h("div", {});
    const find = field("Find in all rounds", h("input", { type: "search", placeholder: "such as: robot 3 died", oninput: () => this.refresh() }));
    this.words = find.control;
    find.box.classList.add("flock-find");
    this.element = h("div", {}, find.box, this.list);
    this.refresh = following(clock, (round) => this.show(round));
  }

  async show(round) {
    const mine = (this.asked += 1);
    const words = this.words.value.trim();
    const asked = (run) => (words ? `find=${encodeURIComponent(words)}` : `round=${Math.min(round, Math.max(0, run.last))}`);
    const found = await Promise.all(this.runs.map((run) => run.get(`events?${asked(run)}`).catch(() => null)));
    if (mine !== this.asked) return;
    this.list.replaceChildren(...found.flatMap((events, k) => (events ? this.listed(events, k) : [h("div", { class: "flock-hint", text: GONE })])));
  }

  listed({ round, total, lines, more: cut }, k) {
    const title = this.runs.length > 1 ? [h("h2", { class: "flock-subtitle", text: this.names[k] })] : [];
    const more = total - lines.length;
    const count = (all) => `${all} ${all === 1 ? "event" : "events"}`;
    const there = (at) => h("button", { type: "button", class: "flock-link", text: `Round ${at}`, onclick: () => this.clock.seek(at) });
    return [...title, h("div", { class: "flock-hint", text: round === null ? `${cut ? "the first " : ""}${count(lines.length)} in all rounds` : `${count(total)} in round ${round}` }),
      ...lines.map(([who, what, at]) => h("div", { class: "flock-event" }, at === undefined ? null : there(at),
        h("span", { class: "flock-who", text: who[0].toUpperCase() + who.slice(1) }), " ", h("span", { class: "flock-what", text: what }))),
      ...(more > 0 ? [h("div", { class: "flock-hint", text: `and ${more} more` })] : [])];
  }
}

// Orders to runs in flight. A button is off where its order makes no sense, and says why; the server refuses it as well.
import { button, choice, field, fill, h, order, paceOf, paceSlider } from "llm-flock-viewer/dom.js";

export class Steer {
  constructor(runs, keys) {
    this.runs = runs;
    this.keys = keys;
    this.built = "";
    this.element = h("div", { class: "flock-steer" });
  }

  /** Whether any of the runs takes orders. */
  get state() {
    const found = this.runs.map((run) => run.steer).filter(Boolean);
    return found.find((one) => one.run === null) || found[0] || null;
  }

  draw() {
    const { state } = this;
    if (!state) return;
    if (this.built !== state.kind) this.build(state);
    this.built = state.kind;
    const text = JSON.stringify([state, this.robot && this.robot.value]);
    if (text === this.text) return;
    this.text = text;
    for (const [made, why] of this.buttons) {
      const reason = why(state);
      made.disabled = Boolean(reason);
      made.title = reason || "";
    }
    for (const control of [this.pace, this.loss].filter(Boolean)) control.disabled = Boolean(state.run);
    const robot = this.robot ? Number(this.robot.value) : 0;
    const reasons = state.run ? [state.run] : state.kind === "run" ? [state.kill[robot], state.hallucinate[robot]].filter(Boolean) : [];
    this.why.textContent = [...new Set(reasons)].join(" ");
    if (this.hold) this.hold.textContent = state.paused ? "Let the run fly on" : "Hold the run";
  }

  build(state) {
    this.said = h("div", { class: "flock-hint flock-steered", role: "status" });
    this.why = h("div", { class: "flock-why-not", id: "flock-why-not" });
    this.buttons = [];
    const act = (text, asked, why, name = "") => {
      const made = button(text, () => this.give(asked()), { name });
      made.setAttribute("aria-describedby", this.why.id);
      this.buttons.push([made, why]);
      return made;
    };
    const run = (now) => now.run;
    const parts = [h("div", { class: "flock-steer-said" }, this.said, this.why)];
    if (state.kind === "run") {
      const words = (value) => `${value} rounds a second`;
      this.pace = paceSlider(state.pace, words);
      this.hold = act("Hold the run", () => ({ order: "hold", paused: !this.state.paused }), run);
      parts.push(h("h2", { class: "flock-subtitle", text: "The run" }), this.slider("Pace", this.pace, () => words(paceOf(this.pace)),
        () => ({ order: "pace", pace: paceOf(this.pace) })),
      h("div", { class: "flock-row" }, this.hold, act("End the run", () => ({ order: "end" }), run)),
      h("div", { class: "flock-hint", text: "Holding stops the robots. The button below the arena stops only the picture." }));
    }
    parts.push(...this.mission(state, act, run));
    if (state.kind === "run") {
      this.robot = choice(state.kill.map((_, k) => k), 0, () => this.draw());
      this.loss = h("input", { type: "range", min: 0, max: 0.9, step: 0.1, value: state.loss });
      const robot = () => Number(this.robot.value);
      parts.push(h("h2", { class: "flock-subtitle", text: "Faults" }), field("Robot to disturb", this.robot).box,
        h("div", { class: "flock-row" },
          act("Kill", () => ({ order: "kill", robot: robot() }), (now) => now.run || now.kill[robot()], "flock-danger"),
          act("Hallucinate", () => ({ order: "hallucinate", robot: robot() }), (now) => now.run || now.hallucinate[robot()], "flock-danger")),
        this.slider("Messages lost", this.loss, (value) => `${Math.round(100 * value)} %`, (value) => ({ order: "lose", loss: value })));
    }
    this.element.replaceChildren(...parts);
  }

  slider(label, control, words, asked) {
    const shown = h("output", { class: "flock-value", text: words(Number(control.value)) });
    const made = field(label, control);
    control.addEventListener("input", () => { shown.textContent = words(Number(control.value)); });
    control.addEventListener("change", () => this.give(asked(Number(control.value))));
    made.box.querySelector("label").append(" ", shown);
    return made.box;
  }

  mission(state, act, run) {
    const first = state.mission || { shape: "circle", center: [50, 50] };
    const known = this.runs[0].steer && this.runs[0].missions.length ? this.runs[0].missions.at(-1).text.split(" of ")[0] : first.shape;
    this.fields = {
      shape: field("Shape", h("input", { value: known, list: "flock-shapes" })),
      center: field("Centre", h("input", { placeholder: "as before" }), "x, y; empty: as before"),
      ...(state.kind === "run" ? { spacing: field("Spacing", h("input", { type: "number", min: 0, step: "any", placeholder: "as before" })) } : {}),
    };
    const list = h("datalist", { id: "flock-shapes" });
    this.fields.shape.control.addEventListener("focus", () => {
      fetch("/data/shapes").then((answer) => answer.json()).then((shapes) => fill(list, shapes.map((one) => one.name), ""), () => {});
    }, { once: true });
    return [h("h2", { class: "flock-subtitle", text: "Another mission" }), list,
      h("div", { class: "flock-choose" }, ...Object.values(this.fields).map((one) => one.box)),
      h("div", { class: "flock-row" }, act("Give the mission", () => ({ order: "change", fields: this.values() }), run),
        act("Go on to the next stage", () => ({ order: "proceed" }), run)),
      ...this.words()];
  }

  /** A mission or an edit in words: what the model made of it is shown, and given once it is confirmed. */
  words() {
    const box = field("In words", h("textarea", { rows: 2 }), "a mission, or a change of the drawing: wider");
    const offer = h("div", {});
    let asking = false;
    const ask = (now) => { asking = now; this.text = ""; this.draw(); };
    const read = (edit) => async () => {
      ask(true);
      offer.replaceChildren(h("div", { class: "flock-hint", role: "status", text: "asking the model …" }));
      const said = await order({ order: "read", runs: this.keys, words: box.control.value, edit });
      ask(false);
      offer.replaceChildren(h("div", { class: said.error ? "flock-error" : "flock-said", role: "status", text: said.error || said.in_words }));
      if (said.draft) offer.append(button("Give it", () => this.give({ order: "change", draft: said.draft })));
    };
    const reads = [button("Read the mission", read(false)), button("Read the change", read(true))];
    this.buttons.push(...reads.map((one) => [one, (now) => now.run || (asking && "The model is asked already.")]));
    return [box.box, offer, h("div", { class: "flock-row" }, ...reads)];
  }

  values() {
    const { shape, center, spacing } = this.fields;
    const numbers = center.control.value.trim();
    return {
      shape: shape.control.value.trim(),
      ...(numbers ? { center: numbers.split(",").map((part) => (part.trim() === "" ? NaN : Number(part))).map((value) => (Number.isNaN(value) ? numbers : value)) } : {}),
      ...(spacing && spacing.control.value ? { spacing: Number(spacing.control.value) } : {}),
    };
  }

  async give(asked) {
    for (const one of Object.values(this.fields)) one.say("");
    const said = await order({ runs: this.keys, ...asked });
    const wrong = said.error && this.fields[said.field];
    if (wrong) wrong.say(said.error);
    this.said.textContent = said.error ? `error: ${said.error}` : said.done;
    this.said.classList.toggle("flock-error", Boolean(said.error));
  }
}

// The form that starts simulated runs, one or two side by side, and reads missions in plain words.
import { button, choice, field, h, header, order, paceOf, paceSlider } from "llm-flock-viewer/dom.js";
import { listenToKeys, showKeys } from "llm-flock-viewer/keys.js";
import { Ground } from "llm-flock-viewer/ground.js";
import { shapePictures } from "llm-flock-viewer/shapes.js";

const number = (value, about = {}) => h("input", { type: "number", value, step: "any", ...about });

/** Build the page. */
export function cockpit(options, place) {
  const shape = h("input", { value: "circle", autocomplete: "off" });
  const pictures = shapePictures(options.shapes, shape);
  const models = h("datalist", { id: "flock-models" }, ...options.models.map(([name, about]) => h("option", { value: name, text: about })));
  const loss = h("input", { type: "range", min: 0, max: 0.9, step: 0.05, value: 0 });
  const pace = paceSlider(4, (value) => `${value} rounds a second`);
  const fields = {
    shape: field("Shape", shape, "A name, where needed with an argument: circle, polygon:5, text:HI"),
    n_robots: field("Robots", number(10, { step: 1 })),
    center: field("Centre", h("input", { value: "50, 50" }), "x, y"),
    spacing: field("Spacing", number(10), "between neighbours [units]"),
    protocol: field("Protocol", choice(options.protocols.map(([name]) => [name, name]), "flock"), " "),
    model: field("Model", h("input", { value: "simulated:distorted@0.3,overshoot@0.3", list: models.id, autocomplete: "off" }),
      "simulated:… plays a language model with faults; no model is asked"),
    seed: field("Seed", number(0, { step: 1 }), "the same seed, the same run"),
    rounds: field("Rounds at most", number(200, { step: 1 })),
    start: field("Starts", choice(options.starts, "separated")),
    gaps: field("Places of the dead", choice(options.gaps.map(([name]) => [name, name]), "report"), " "),
    loss: field("Messages lost", loss),
    pace: field("Rounds a second", pace),
  };
  shown(fields.loss, (value) => `${Math.round(100 * value)} %`);
  shown(fields.pace, () => `${paceOf(pace)}`);
  for (const [one, about] of [[fields.protocol, options.protocols], [fields.gaps, options.gaps]]) {
    const told = () => { one.box.querySelector(".flock-hint").textContent = Object.fromEntries(about)[one.control.value]; };
    one.control.addEventListener("change", told);
    told();
  }
  const on = h("input", { type: "checkbox", checked: true });
  const ground = new Ground(() => values(fields, on), fields.center.control);
  const redraw = (event) => ground.ask(["seed", "start", "n_robots"].some((name) => fields[name].control === event.target));
  const said = h("div", { class: "flock-error", role: "alert" });
  const waits = h("span", { class: "flock-hint", role: "status" });
  const starts = [];
  const launch = async (protocols, draft = null) => {
    for (const one of Object.values(fields)) one.say("");
    said.textContent = "";
    waits.textContent = "Starting …";
    for (const one of starts) one.disabled = true;
    const answer = await order({ order: "start", protocols, draft, pace: paceOf(pace), fields: { ...values(fields, on), start_positions: ground.moved } });
    if (answer.address) {
      clearTimeout(ground.due); // a page that is left asks nothing more
      location.href = answer.address;
      return;
    }
    waits.textContent = "";
    for (const one of starts) one.disabled = false;
    const wrong = fields[answer.field === "start_positions" ? "start" : answer.field];
    if (wrong) {
      wrong.say(answer.error);
      wrong.control.focus();
      said.textContent = `Nothing started: look at “${wrong.box.querySelector("label").firstChild.textContent.trim()}”.`;
    } else said.textContent = answer.error;
  };
  starts.push(button("Start", () => launch(null), { name: "flock-main" }), button("Paper against flock, side by side", () => launch(["paper", "flock"])));
  // A page that is gone back to is as it was left.
  addEventListener("pageshow", () => {
    waits.textContent = "";
    for (const one of starts) one.disabled = false;
  });
  const form = h("section", { class: "flock-card", "aria-label": "New run" }, h("h2", { class: "flock-subtitle", text: "Fly a simulated run" }),
    pictures.element, models,
    h("div", { class: "flock-form" }, ...Object.entries(fields).map(([name, one]) => {
      if (name === "protocol" || name === "model") one.box.classList.add("flock-wide");
      return one.box;
    })), ground.element,
    h("label", { class: "flock-check" }, on, "Keep flying after it has formed"), said,
    h("div", { class: "flock-row" }, ...starts, waits));
  form.addEventListener("change", redraw);
  const spoken = words(options, (draft) => launch(null, draft), starts);
  listenToKeys({ "?": showKeys });
  // Without a model the words cannot be read: then the form comes first.
  place.replaceChildren(header("Cockpit", [["Runs", "/runs"]], [], showKeys),
    h("main", { class: "flock-page" }, ...(options.reads ? [spoken, form] : [form, spoken])));
}

/** A slider's value beside its label. */
function shown(one, text) {
  const value = h("output", { class: "flock-value", text: text(Number(one.control.value)) });
  one.control.addEventListener("input", () => { value.textContent = text(Number(one.control.value)); });
  one.box.querySelector("label").append(" ", value);
}

function values(fields, on) {
  const found = {};
  for (const [name, one] of Object.entries(fields)) {
    if (name === "pace") continue;
    const { value, type } = one.control;
    found[name] = value.trim() !== "" && (type === "number" || type === "range") ? Number(value) : value.trim();
  }
  // What is no list of numbers is sent as it is, and refused in words.
  const parts = found.center.replace(/^[([]|[)\]]$/g, "").split(",").map((part) => part.trim());
  if (found.center && parts.every((part) => part !== "" && !Number.isNaN(Number(part)))) found.center = parts.map(Number);
  return { ...found, stop_when_formed: !on.checked };
}

/** `starts` are the buttons that start a run. */
function words(options, take, starts) {
  const box = field("Mission in plain words", h("textarea", { rows: 2, placeholder: "eight drones in a square around 40, 60, 8 apart" }));
  const note = h("div", { class: "flock-hint", role: "status", text: options.reads ? "" : options.needs });
  const offer = h("div", {});
  const read = button("Read", async () => {
    offer.replaceChildren();
    note.textContent = "asking the model …";
    read.disabled = true;
    const said = await order({ order: "read", words: box.control.value });
    read.disabled = false;
    if (said.error) {
      note.textContent = `error: ${said.error}`;
      return;
    }
    note.textContent = "This is what the model made of it. Protocol, model and faults are those of the form. Nothing flies before you say so.";
    const fly = button("Fly it", () => take(said.draft));
    starts.push(fly);
    offer.append(h("div", { class: "flock-call" }, h("div", { class: "flock-said", text: said.in_words }), fly));
  });
  read.disabled = box.control.disabled = !options.reads;
  return h("section", { class: "flock-card", "aria-label": "Say it in words" }, h("h2", { class: "flock-subtitle", text: "Say it in words" }),
    box.box, note, offer, h("div", { class: "flock-row" }, read));
}

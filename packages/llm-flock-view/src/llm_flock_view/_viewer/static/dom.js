// Elements of a page. Whatever comes from a run is set as text, never as markup.

/** An element: attributes, `text`, and listeners by names such as `onclick`; children are elements or texts. */
export function h(kind, about = {}, ...children) {
  const made = document.createElement(kind);
  for (const [name, value] of Object.entries(about)) {
    if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else if (name === "text") made.textContent = value;
    else if (value === true) made.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) made.setAttribute(name, value);
  }
  made.append(...children.filter((child) => child !== null && child !== undefined));
  return made;
}

const SVG = "http://www.w3.org/2000/svg";

/** A small picture beside words that say the same; screen readers skip it. */
export function picture(width, height, parts) {
  const made = document.createElementNS(SVG, "svg");
  for (const [name, value] of Object.entries({ viewBox: `0 0 ${width} ${height}`, width, height, "aria-hidden": "true" })) {
    made.setAttribute(name, value);
  }
  for (const [kind, about] of parts) {
    const part = document.createElementNS(SVG, kind);
    for (const [name, value] of Object.entries(about)) {
      if (name === "text") part.textContent = value;
      else part.setAttribute(name, value);
    }
    made.append(part);
  }
  return made;
}

/** A button; `words` name it for a screen reader and in its tooltip where its text is a sign. */
export function button(text, act, { words = "", name = "" } = {}) {
  const about = { type: "button", class: `flock-button ${name}`.trim(), text, onclick: act };
  return h("button", words ? { ...about, "aria-label": words, title: words } : about);
}

/** A field with its label above it, and a place for what is wrong with it. */
export function field(label, control, hint = "") {
  const id = `flock-field-${(field.made = (field.made || 0) + 1)}`;
  control.id = id;
  const wrong = h("div", { class: "flock-wrong", id: `${id}-wrong` });
  control.setAttribute("aria-describedby", wrong.id);
  const box = h("div", { class: "flock-labelled" }, h("label", { for: id, text: label }), control,
    hint ? h("div", { class: "flock-hint", text: hint }) : null, wrong);
  return { box, control, say(text) {
    wrong.textContent = text;
    control.setAttribute("aria-invalid", text ? "true" : "false");
  } };
}

const PACES = [0.1, 0.2, 0.5, 1, 2, 3, 4, 5, 7, 10, 15, 20, 30, 50, 70, 100]; // as the viewer takes them [rounds a second]

/** A slider over paces, finer where they are slow; a screen reader says the pace, and not the number of its notch. */
export function paceSlider(pace, words) {
  const far = PACES.map((one) => Math.abs(Math.log(one / pace)));
  const made = h("input", { type: "range", min: 0, max: PACES.length - 1, step: 1, value: far.indexOf(Math.min(...far)) });
  const say = () => made.setAttribute("aria-valuetext", words(paceOf(made)));
  made.addEventListener("input", say);
  say();
  return made;
}

/** The pace of such a slider [rounds a second]. */
export function paceOf(slider) {
  return PACES[Number(slider.value)];
}

/** Options of a list: pairs of value and text, or values. */
export function choice(options, value, change = () => {}) {
  const made = h("select", { onchange: () => change(made.value) });
  fill(made, options, value);
  return made;
}

/** Replace the options of a list. */
export function fill(list, options, value) {
  list.replaceChildren(...options.map((one) => {
    const [own, text] = Array.isArray(one) ? one : [one, one];
    return h("option", { value: own, text });
  }));
  list.value = String(value);
}

/** Ask for JSON; an error of the server is raised in its own words. */
export async function order(asked) {
  let answer;
  try {
    answer = await fetch("/order", {
      method: "POST", credentials: "same-origin", headers: { "content-type": "application/json" }, body: JSON.stringify(asked),
    });
  } catch {
    return { error: "The viewer does not answer: is its command still running?", field: null };
  }
  const type = answer.headers.get("content-type") || "";
  return type.startsWith("application/json") ? answer.json() : { error: await answer.text(), field: null };
}

/** The header of every page; `extra` are elements between the links and the buttons at its end. */
export function header(title, links, extra, help) {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const stored = () => { try { return localStorage.getItem("flock-dark"); } catch { return null; } };
  const dress = () => document.body.classList.toggle("body--dark", stored() ? stored() === "1" : dark.matches);
  dark.addEventListener("change", dress);
  dress();
  const turn = () => {
    const now = !document.body.classList.contains("body--dark");
    try { localStorage.setItem("flock-dark", now ? "1" : "0"); } catch { /* a page from a file keeps nothing */ }
    document.body.classList.toggle("body--dark", now);
  };
  return h("header", { class: "flock-header" },
    links.length ? h("a", { class: "flock-brand", href: "/", text: "LLM-Flock" }) : h("span", { class: "flock-brand", text: "LLM-Flock" }),
    h("h1", { class: "flock-title", text: title }), h("span", { class: "flock-grow" }),
    ...links.map(([text, href]) => h("a", { href, text })), ...extra,
    help ? button("?", help, { words: "Keys (?)", name: "flock-quiet" }) : null,
    button("◐", turn, { words: "Light or dark", name: "flock-quiet" }));
}

/** A dialog that closes with Escape, its button, or a click beside it; `acts` are more buttons. */
export function dialog(title, content, acts = [], leave = "Close") {
  const made = h("dialog", { class: "flock-dialog", "aria-label": title });
  const close = () => made.close();
  made.append(h("h2", { text: title }), content, h("div", { class: "flock-row" },
    ...acts.map(([text, act, name]) => button(text, () => { close(); act(); }, { name })), button(leave, close)));
  made.addEventListener("click", (event) => { if (event.target === made) close(); });
  made.addEventListener("close", () => made.remove());
  document.body.append(made);
  made.showModal();
  return made;
}

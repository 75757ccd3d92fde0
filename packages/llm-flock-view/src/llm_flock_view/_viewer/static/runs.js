// The table of runs: sort, filter, compare, delete.
import { SIGNS } from "llm-flock-viewer/banner.js";
import { button, dialog, h, header, order, picture } from "llm-flock-viewer/dom.js";
import { listenToKeys, showKeys } from "llm-flock-viewer/keys.js";

const SIZE = 56;
const REFRESH_MS = 1500; // runs go on, and new records come

/** Columns: title, how a row is sorted, and what its cell shows. */
const COLUMNS = [
  ["Run", (row) => row.title.toLowerCase(), (row) => [h("a", { href: `/run/${row.key}`, text: row.title }), h("div", { class: "flock-hint", text: row.mission || "" })]],
  ["Outcome", (row) => row.outcome || "", (row) => [h("div", { class: `flock-tone flock-tone-${row.tone}` },
    h("span", { "aria-hidden": "true", text: `${SIGNS[row.tone] || ""} ` }), row.outcome || row.failure || "reading …"),
  row.why ? h("div", { class: "flock-hint", text: row.why }) : null]],
  ["Date", (row) => row.date || "", (row) => [row.date || ""]],
  ["Protocol", (row) => row.protocol || "", (row) => [row.protocol || ""]],
  ["Model", (row) => row.model || "", (row) => [h("div", { class: "flock-model", text: (row.model || "").replaceAll(",", ", ") })]],
  ["Rounds / bound", (row) => row.ratio ?? Infinity, (row) => [!row.ready ? "" : row.ratio === null ? `${row.rounds} flown`
    : `${row.took} / ${row.bound} = ${row.ratio.toFixed(2)}`]],
  ["Seed", (row) => row.seed ?? -1, (row) => [String(row.seed ?? "")]],
  ["Loss", (row) => row.loss ?? -1, (row) => [row.loss ? `${Math.round(100 * row.loss)} %` : ""]],
  ["Deaths", (row) => row.deaths ?? -1, (row) => [row.deaths ? String(row.deaths) : ""]],
  ["Calls", (row) => row.calls ?? -1, (row) => [row.calls === undefined ? "" : String(row.calls)]],
];

/** Build the page. */
export function runs(options, place) {
  const state = { rows: [], sort: 2, down: true, words: "", chosen: new Set() };
  const body = h("tbody", { role: "rowgroup" });
  const compared = h("div", { class: "flock-compared" });
  const count = h("div", { class: "flock-hint", role: "status" });
  const filter = h("input", { type: "search", id: "flock-filter", oninput: () => {
    state.words = filter.value.toLowerCase();
    draw();
  } });
  const heads = COLUMNS.map(([title], k) => h("th", { scope: "col", role: "columnheader" }, h("button", { type: "button", class: "flock-sort", text: title, onclick: () => {
    state.down = state.sort === k ? !state.down : false;
    state.sort = k;
    draw();
  } })));
  const draw = () => {
    heads.forEach((head, k) => {
      const sorted = state.sort === k ? (state.down ? "descending" : "ascending") : "none";
      head.setAttribute("aria-sort", sorted);
      head.firstChild.textContent = COLUMNS[k][0] + { none: "", ascending: " ▲", descending: " ▼" }[sorted];
    });
    const wanted = state.words.split(/\s+/).filter(Boolean);
    const matches = (row) => {
      const text = [row.title, row.outcome, row.protocol, row.model, row.mission, row.date, `seed ${row.seed}`].join(" ").toLowerCase();
      return wanted.every((word) => text.includes(word));
    };
    const key = COLUMNS[state.sort][1];
    const order = (a, b) => (key(a) < key(b) ? -1 : key(a) > key(b) ? 1 : a.key < b.key ? -1 : 1) * (state.down ? -1 : 1);
    const listed = state.rows.filter(matches).sort(order);
    body.replaceChildren(...listed.map((row) => line(row, state, draw, load)));
    count.textContent = state.rows.length ? `${listed.length} of ${state.rows.length} ${state.rows.length === 1 ? "run" : "runs"}` : "None yet: the cockpit starts them.";
    compared.replaceChildren(...comparison(state, options));
  };
  const load = async () => {
    try {
      const answer = await fetch(`/data/runs?seen=${state.changes}`, { credentials: "same-origin" });
      const { changes, rows } = await answer.json();
      state.changes = changes;
      if (rows && JSON.stringify(rows) !== JSON.stringify(state.rows)) {
        state.rows = rows;
        for (const key of state.chosen) if (!rows.some((row) => row.key === key)) state.chosen.delete(key);
        draw();
      }
    } catch {
      count.textContent = "The viewer does not answer: is its command still running?";
    }
    clearTimeout(state.next); // a row that was deleted asks at once
    state.next = setTimeout(load, REFRESH_MS);
  };
  listenToKeys({ "?": showKeys });
  place.replaceChildren(header("Runs", [["Cockpit", "/cockpit"]], [], showKeys),
    h("main", { class: "flock-page flock-broad" }, h("section", { class: "flock-card", "aria-label": "All runs" },
      h("div", { class: "flock-row" }, h("label", { for: "flock-filter", text: "Search" }), filter, count), compared,
      h("div", { class: "flock-scroll", tabindex: "0", role: "region", "aria-label": "Table of runs" }, h("table", { class: "flock-table flock-runs", role: "table" },
        h("thead", { role: "rowgroup" }, h("tr", { role: "row" }, h("th", { scope: "col", text: "Compare" }), h("th", { scope: "col", text: "Last round" }), ...heads, h("th", { scope: "col", text: "Delete" }))),
        body)))));
  load();
}

function line(row, state, draw, load) {
  const box = h("input", { type: "checkbox", "aria-label": `Compare ${row.title}` });
  box.checked = state.chosen.has(row.key);
  box.addEventListener("change", () => {
    state.chosen[box.checked ? "add" : "delete"](row.key);
    draw();
    const again = document.querySelector(`[data-key="${row.key}"] input`);
    if (again) again.focus();
  });
  const remove = button("Delete", () => ask(row, load), { words: `Delete ${row.title}` });
  remove.disabled = !row.deletable;
  if (!row.deletable) remove.title = row.open ? "The run is not over: end it first." : "There is no record to delete.";
  const dots = (row.thumbnail || []).map(([x, y, fill]) => ["circle", { cx: 5 + x * (SIZE - 10), cy: 5 + y * (SIZE - 10), r: 2.5, fill, class: "k-dot" }]);
  // Roles and names of cells: on a phone a row is a card, and no table any more.
  const cell = (label, ...content) => h("td", { role: "cell", "data-label": label }, ...content);
  return h("tr", { role: "row", "data-key": row.key }, cell("Compare", box), cell("", picture(SIZE, SIZE, dots)),
    ...COLUMNS.map(([title, , shown]) => cell(title, ...shown(row))), cell("", remove));
}

function ask(row, load) {
  dialog("Delete this record?", h("p", { text: `The record of “${row.title}” is deleted from the disk. This cannot be undone.` }),
    [["Delete", async () => {
      const said = await order({ order: "delete", run: row.key });
      if (said.error) dialog("Not deleted", h("p", { text: said.error }));
      load();
    }, "flock-danger"]], "Keep it");
}

/** A number as people read it: 46,810 tokens, and no powers of ten for what is next to nothing. */
function figure(value) {
  if (value && Math.abs(value) < 0.0005) return "< 0.001";
  return value.toLocaleString("en", Number.isInteger(value) ? {} : { maximumSignificantDigits: 4 });
}

/** Figures of the chosen runs beside one another. */
function comparison(state, options) {
  const rows = state.rows.filter((row) => state.chosen.has(row.key) && row.ready);
  if (!rows.length) return [];
  const basic = [["Outcome", (row) => row.outcome], ["Protocol", (row) => row.protocol], ["Model", (row) => row.model && row.model.replaceAll(",", ", ")], ["Seed", (row) => row.seed],
    ["Rounds to form", (row) => row.took], ["Lower bound", (row) => row.bound], ["Rounds / bound", (row) => row.ratio], ["Calls", (row) => row.calls]];
  const figures = options.figures.map((label, k) => [label, (row) => row.figures[k][1]]);
  const text = (value) => (value === null || value === undefined ? "–" : typeof value === "number" ? figure(value) : value);
  const pair = rows.length === 2 ? h("a", { href: `/pair/${rows[0].key}/${rows[1].key}`, text: "Play these two side by side" }) : null;
  return [h("h2", { class: "flock-subtitle", text: "Compared" }), h("div", { class: "flock-scroll", tabindex: "0", role: "region", "aria-label": "Comparison" },
    h("table", { class: "flock-table" }, h("thead", {}, h("tr", {}, h("td", {}), ...rows.map((row) => h("th", { scope: "col", text: row.title })))),
      h("tbody", {}, ...[...basic, ...figures].map(([label, value]) => h("tr", {}, h("th", { scope: "row", text: label }),
        ...rows.map((row) => h("td", { text: text(value(row)) }))))))), pair,
  rows.length < 2 ? h("div", { class: "flock-hint", text: "Choose more runs to compare them." }) : null].filter(Boolean);
}

// The page of one run, or of two side by side: what came of it, arena, time line, mind, plots and events.
import { button, dialog, h, header } from "llm-flock-viewer/dom.js";
import { listenToKeys, showKeys } from "llm-flock-viewer/keys.js";
import { Clock } from "llm-flock-viewer/clock.js";
import { Recording } from "llm-flock-viewer/recording.js";
import { Arena, CROWD } from "llm-flock-viewer/arena.js";
import { choices } from "llm-flock-viewer/arena_view.js";
import { Moment } from "llm-flock-viewer/moment.js";
import { Timeline } from "llm-flock-viewer/timeline.js";
import { Plots } from "llm-flock-viewer/plots.js";
import { Banner, Ends } from "llm-flock-viewer/banner.js";
import { legend } from "llm-flock-viewer/legend.js";
import { Events, Minds } from "llm-flock-viewer/mind.js";
import { Steer } from "llm-flock-viewer/steer.js";
import { transport } from "llm-flock-viewer/transport.js";

const FITS = { formation: "Show the formation of the last round", way: "Show the whole way of the team", arena: "Show the whole arena" };
const NARROW = "(max-width: 860px)"; // windows in which all parts stand one below the other

/** Build the page in an element; `held` answers for a page that holds its run. */
export function player(options, place, held = null) {
  const clock = new Clock();
  globalThis.flockClock = () => clock;
  const runs = options.runs.map(({ key }) => new Recording(key, held));
  const pair = runs.length > 1;
  const names = short(options.runs.map((run) => run.title));
  const layers = Object.fromEntries(options.layers.map(([name, , on]) => [name, on]));
  // The lists of the mind panel come last; the arenas tell them of clicks.
  let minds = null;
  let tabs = null;
  const choose = (k) => (robot, second) => {
    tabs.open("Mind");
    minds.choose(k, robot, second);
  };
  const figures = runs.map((run, k) => {
    const part = h("div", { class: "flock-part" });
    const show = (robot) => {
      arenas[k].select([robot]);
      choose(k)(robot, false);
    };
    const banner = new Banner(run, k, pair, clock, show);
    return { part, element: h("figure", { class: "flock-arena" },
      pair ? h("figcaption", { class: "flock-caption", text: names[k] }) : null, banner.element, part) };
  });
  const line = h("div", { class: "flock-part" });
  const plots = h("div", { class: "flock-part" });
  const ends = pair ? new Ends(runs, names, clock) : null;
  const note = h("p", { class: "flock-hint flock-unknown", hidden: true, text: "A line ends with ? where its figure is not known: the shape error while robots are missing." });
  const help = legend(!pair, layers);
  minds = held ? null : new Minds(runs, names, clock, (k, robots) => arenas[k].select(robots));
  const happened = new Events(runs, names, clock);
  const steer = held ? null : new Steer(runs, options.runs.map((run) => run.key));
  tabs = panels([
    ...(minds ? [["Mind", minds.element, ""]] : []), ["Plots", h("div", { class: "flock-charts" }, ends ? ends.element : null, note, plots), "flock-plots"], ["Events", happened.element, ""],
    ...(steer ? [["Steer", steer.element, ""]] : []),
  ], minds && !pair ? "Mind" : "Plots", steer ? ["Steer"] : []);
  const arenas = [];
  const chosen = choices();
  // An exported page is its own address.
  const moment = () => new Moment({ clock, arenas, tabs, minds }, held ? location.pathname : `/${pair ? "pair" : "run"}/${runs.map((run) => run.key).join("/")}`,
    held ? "The link leads into this page: send the page along." : "The link opens in a viewer that shows this record: send the record along, from Export. Or send its replay, a page that needs no viewer.");
  const all = (act) => () => arenas.forEach(act);
  const show = (name, on) => {
    help.show(name, on);
    for (const one of arenas) one.layer(name, on);
  };
  const link = h("span");
  const field = fieldOf(options, figures, help, show, all);
  place.replaceChildren(
    header(options.title, held ? [] : [["Runs", "/runs"], ["Cockpit", "/cockpit"]], [link, held ? null : exports(options, runs, names, clock)], showKeys),
    h("main", { class: `flock-player${pair ? " flock-pair" : ""}` },
      field,
      h("aside", { class: "flock-side", "aria-label": "Mind, plots and events" }, tabs.element),
      h("section", { class: "flock-time", "aria-label": "Time" }, transport(runs, names, clock), minds && minds.brief, line)));
  if (minds) minds.brief.addEventListener("click", () => { tabs.open("Mind"); minds.element.scrollIntoView(); });
  runs.forEach((run, k) => {
    arenas.push(new Arena(figures[k].part, run, clock, { title: names[k], layers, chosen, peers: runs }, (robot, second) => {
      if (minds) choose(k)(robot, second);
    }));
  });
  new Timeline(line, runs, clock, { tracks: options.tracks, names });
  new Plots(plots, runs, clock, { charts: options.charts, names, note });
  clock.listen(() => {
    const space = runs.some((run) => run.about && run.about.space);
    help.show("space", space);
    if (space) field.inSpace();
    help.show("crowd", runs.some((run) => run.about && run.about.robots > CROWD));
    help.show("repeated", runs.some((run) => run.plans.some((plan) => plan.rim !== "-")));
  });
  if (steer) clock.listen(() => steered(steer, tabs));
  const { act, note: copied } = moment();
  link.replaceWith(act, copied);
  keys(clock, arenas, help);
  for (const run of runs) clock.attach(run);
}

/** The arenas with their banners, layers and legend. In narrow windows what came of the run is first. */
function fieldOf(options, figures, help, show, all) {
  const layers = h("div", { class: "flock-layers" }, ...options.layers.map(([name, words, on]) => h("label", {},
    h("input", { type: "checkbox", checked: on, onchange: (event) => show(name, event.target.checked) }), words)),
  h("span", { class: "flock-grow" }), help.act);
  const zoom = h("div", { class: "flock-zoom", role: "group", "aria-label": "What is shown" },
    button("−", all((one) => one.view.zoom(0.8)), { words: "Zoom out" }), button("+", all((one) => one.view.zoom(1.25)), { words: "Zoom in" }),
    ...[["Formation", "formation", "F"], ["Way", "way", "0"], ["Arena", "arena", "A"]].map(([text, what, key]) =>
      button(text, all((one) => one.view.fit(what)), { words: `${FITS[what]} (${key})` })));
  const space = h("span", { class: "flock-views", hidden: true }, ...[["Space", undefined, "in perspective, turned by a drag (V)"], ["Top", "top", "seen from above (T)"], ["Side", "side", "seen from the side (S)"]]
    .map(([text, from, how]) => button(text, all((one) => one.view.look(from)), { words: `${text}, ${how}` })));
  zoom.prepend(space);
  const arenas = h("div", { class: "flock-arenas" }, ...figures.map((one) => one.element), zoom);
  const made = h("section", { class: "flock-field", "aria-label": "Arena" });
  made.inSpace = () => { space.hidden = false; };
  const narrow = matchMedia(NARROW);
  const fit = () => {
    if (narrow.matches) made.append(arenas, layers, help.element);
    else {
      made.append(layers, arenas);
      arenas.prepend(help.element);
    }
  };
  fit();
  narrow.addEventListener("change", fit);
  return made;
}

/** Titles without the parts that they share, so that two runs are told apart at a glance. */
function short(titles) {
  const parts = titles.map((title) => title.split(", "));
  const shared = (part) => parts.every((one) => one.includes(part));
  return titles.map((title, k) => (titles.length > 1 && parts[k].filter((part) => !shared(part)).join(", ")) || title);
}

/** The tab that steers is there for runs that take orders, and is open at first while they fly. */
function steered(steer, tabs) {
  if (!steer.state) return;
  steer.draw();
  if (tabs.reveal("Steer") && !steer.state.run) tabs.open("Steer");
}

function keys(clock, arenas, help) {
  const all = (act) => () => arenas.forEach(act);
  const step = 40;
  listenToKeys({
    " ": () => clock.toggle(), ArrowLeft: () => clock.step(-1), ArrowRight: () => clock.step(1),
    Home: () => clock.seek(0), End: () => clock.live(),
    "+": all((one) => one.view.zoom(1.25)), "=": all((one) => one.view.zoom(1.25)), "-": all((one) => one.view.zoom(0.8)),
    0: all((one) => one.view.fit("way")), ...both("a", all((one) => one.view.fit("arena"))),
    ...both("f", all((one) => one.view.fit("formation"))), ...both("l", () => help.act.click()),
    ShiftArrowLeft: all((one) => one.view.pan(step, 0)), ShiftArrowRight: all((one) => one.view.pan(-step, 0)),
    ShiftArrowUp: all((one) => one.view.pan(0, step)), ShiftArrowDown: all((one) => one.view.pan(0, -step)),
    ...both("v", all((one) => one.view.look())), ...both("t", all((one) => one.view.look("top"))), ...both("s", all((one) => one.view.look("side"))),
    ",": all((one) => one.view.turn(-10, 0)), ".": all((one) => one.view.turn(10, 0)), ";": all((one) => one.view.turn(0, -5)), ":": all((one) => one.view.turn(0, 5)),
    "[": () => focused(arenas).next(-1), "]": () => focused(arenas).next(1),
    "?": showKeys,
  });
}

function both(key, act) {
  return { [key]: act, [key.toUpperCase()]: act };
}

function focused(arenas) {
  return arenas.find((one) => one.surface.canvas === document.activeElement) || arenas[0];
}

/** Tabs and their panels; those named in `hidden` are shown with `reveal`. */
function panels(listed, first, hidden) {
  const list = h("div", { class: "flock-tabs", role: "tablist", "aria-label": "Beside the arena" });
  const made = new Map();
  const open = (name) => {
    for (const [other, { tab, panel }] of made) {
      tab.setAttribute("aria-selected", String(other === name));
      tab.tabIndex = other === name ? 0 : -1;
      panel.hidden = other !== name;
    }
  };
  for (const [name, content, kind] of listed) {
    const id = `flock-tab-${name.toLowerCase()}`;
    const tab = h("button", { type: "button", role: "tab", id, "aria-controls": `${id}-panel`, text: name, onclick: () => open(name) });
    tab.hidden = hidden.includes(name);
    const panel = h("div", { class: `flock-panel ${kind}`.trim(), role: "tabpanel", id: `${id}-panel`, "aria-labelledby": id, tabindex: "0" }, content);
    made.set(name, { tab, panel });
    list.append(tab);
  }
  list.addEventListener("keydown", (event) => {
    const by = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!by) return;
    const names = [...made].filter(([, one]) => !one.tab.hidden).map(([name]) => name);
    const now = names.findIndex((name) => made.get(name).tab === document.activeElement);
    const next = names[(now + by + names.length) % names.length];
    open(next);
    made.get(next).tab.focus();
    event.preventDefault();
  });
  open(first);
  return {
    now: () => [...made].find(([, one]) => !one.panel.hidden)[0].toLowerCase(),
    element: h("div", { class: "flock-tabbed" }, list, ...[...made.values()].map((one) => one.panel)),
    open: (name) => {
      const own = [...made.keys()].find((one) => one.toLowerCase() === name.toLowerCase());
      if (own) open(own);
    },
    reveal: (name) => {
      const { tab } = made.get(name);
      const news = tab.hidden;
      tab.hidden = false;
      return news;
    },
  };
}

/** What can be saved of each run, in a dialog. */
function exports(options, runs, names, clock) {
  const made = button("Export", () => {
    const said = h("div", { role: "status", class: "flock-hint" });
    const save = async (key, file) => {
      said.textContent = `${file}: being made …`;
      const answer = await fetch(`/export/${key}/${file}`, { credentials: "same-origin" }).catch(() => null);
      if (!answer || !answer.ok) {
        said.textContent = `error: ${answer ? await answer.text() : "the viewer does not answer"}`;
        return;
      }
      const link = h("a", { href: URL.createObjectURL(await answer.blob()), download: runs.length > 1 ? `${key}-${file}` : file });
      link.click();
      URL.revokeObjectURL(link.href);
      said.textContent = `${file}: saved.`;
    };
    dialog("Export", h("div", {}, ...runs.map((run, k) => h("div", {},
      runs.length > 1 ? h("h3", { text: names[k] }) : null,
      h("div", { class: "flock-row" }, ...options.exports.map(([label, file]) => button(label, () => save(run.key, file)))))), said));
  });
  clock.listen(() => { made.hidden = !runs.every((run) => run.about && run.about.export); });
  return made;
}

// The moment that a page shows, in its address: round, robots, tab and view of the arena. A copied link holds no token.
import { button, dialog, h } from "llm-flock-viewer/dom.js";

const WAIT_MS = 300; // between what changes and its address: browsers refuse to change it all the time

export class Moment {
  /** `parts` are the page's clock, arenas, tabs, and its minds, if any; `path` leads to its runs, and `needs` says what a reader of a link needs. */
  constructor(parts, path, needs) {
    Object.assign(this, parts, { path, needs, wanted: {} });
    this.act = button("Copy link", () => this.copy(), { words: "Copy a link to this moment" });
    this.note = h("p", { class: "flock-tip flock-note", role: "status", hidden: true });
    addEventListener("hashchange", () => this.read());
    this.read();
    this.clock.listen(() => this.follow());
  }

  /** What the address says; it is taken up once the rounds and robots that it names are there. */
  read() {
    this.seen = location.hash;
    const said = new URLSearchParams(this.seen.slice(1));
    const round = said.get("round");
    this.wanted = { round: /^\d{1,7}$/.test(round || "") ? Number(round) : null, robots: (said.get("robots") || "").split(",").filter((one) => /^(\d:)?\d+$/.test(one)).slice(0, 2) };
    if (this.wanted.round !== null) this.clock.held = true;
    if (this.wanted.robots.length && this.minds) this.minds.opened = true;
    if (said.get("tab")) this.tabs.open(said.get("tab"));
    if (said.get("view")) for (const one of this.arenas) one.view.take(said.get("view"));
    this.clock.changed();
  }

  follow() {
    const { clock, clock: { runs }, wanted } = this;
    if (wanted.round !== null && (clock.last >= wanted.round || !runs.some((run) => run.open))) {
      clock.playing = false;
      clock.seek(wanted.round);
      wanted.round = null;
    }
    if (wanted.robots.length && runs.every((run) => run.about)) {
      wanted.robots.forEach((one, second) => {
        const [robot, k = 0] = one.split(":").map(Number).reverse();
        if (!this.arenas[k] || robot >= runs[k].about.robots) return;
        if (this.minds) this.minds.choose(k, robot, Boolean(second));
        else this.arenas[k].select([...(second ? this.arenas[k].selected : []), robot]);
      });
      wanted.robots = [];
    }
    if (this.due || wanted.round !== null || wanted.robots.length || !runs.every((run) => run.about)) return;
    this.due = setTimeout(() => {
      this.due = null;
      const now = this.path + this.hash(clock.following);
      if (clock.playing || now === this.written || location.hash !== this.seen) return; // a new address is read first
      this.written = now;
      try { history.replaceState(null, "", now); this.seen = location.hash; } catch { /* a page inside another one has no address of its own */ }
    }, WAIT_MS);
  }

  /** The moment as the end of an address; without its round where the newest one is followed. */
  hash(following) {
    const pair = this.arenas.length > 1;
    const robots = this.arenas.flatMap((one, k) => one.selected.map((robot) => (pair ? `${k}:${robot}` : robot)));
    const parts = { round: following ? null : this.clock.round, robots: robots.join(), tab: this.tabs.now(), view: this.arenas[0].view.code };
    return `#${Object.entries(parts).filter(([, value]) => value !== null && value !== "").map(([name, value]) => `${name}=${value}`).join("&")}`;
  }

  async copy() {
    const link = new URL(this.path + this.hash(false), location.href).href;
    try {
      await navigator.clipboard.writeText(link);
      this.act.textContent = "Copied";
      this.note.hidden = !(this.note.textContent = this.needs);
      setTimeout(() => { this.act.textContent = "Copy link"; this.note.hidden = true; }, 20 * WAIT_MS);
    } catch { // pages without encryption may write no clipboard: it is shown, marked to be copied
      const shown = h("input", { value: link, readonly: true, class: "flock-copy", "aria-label": "Link to this moment" });
      dialog("Link to this moment", h("div", {}, shown, h("p", { text: this.needs })));
      shown.select();
    }
  }
}

// One run in the page: all of its figures, and its robots round by round, fetched when needed.

const KEPT = 40000; // robots times rounds in memory; others are fetched again
const LIVE_MS = 100;
const FIRST_MS = 20; // until there is anything to show

/** One figure of every round, packed: a run may go on for hours. Unknown values are NaN. */
class Column {
  constructor() {
    this.room = new Float64Array(256);
    this.values = this.room.subarray(0, 0);
  }

  push(values) {
    const before = this.values.length;
    const after = before + values.length;
    if (after > this.room.length) {
      const room = new Float64Array(Math.max(2 * this.room.length, after));
      room.set(this.values);
      this.room = room;
    }
    values.forEach((value, k) => {
      this.room[before + k] = value === null ? NaN : value;
    });
    this.values = this.room.subarray(0, after);
  }
}

export class Recording {
  constructor(key, held = null) {
    this.key = key;
    this.held = held;
    this.about = null;
    this.last = -1;
    this.open = true;
    this.fresh = true;
    this.failure = null;
    this.plans = [];
    this.missions = [];
    this.marks = new Map();
    this.figures = {};
    this.extent = [];
    this.formation = [];
    this.outcome = null;
    this.steer = null;
    this.frames = new Map();
    this.asked = new Set();
    this.grown = () => {};
  }

  get block() {
    return Math.max(1, Math.min(64, Math.floor(4000 / (this.about ? this.about.robots : 10))));
  }

  async get(path) {
    if (this.held) return this.held(path); // a page that holds its run
    const answer = await fetch(`/data/${this.key}/${path}`, { credentials: "same-origin" });
    if (!answer.ok) throw new Error(answer.status === 401 ? await answer.text() : `${path}: ${answer.status}`);
    return answer.json();
  }

  async start(grown) {
    this.grown = grown;
    for (;;) {
      const began = performance.now();
      try {
        if (!this.about) {
          const about = await this.get("about");
          if (about.ready) this.about = about;
          else this.failure = about.failure;
        }
        const known = `rounds=${this.last + 1}&plans=${this.plans.length}&missions=${this.missions.length}`;
        if (this.about) this.take(await this.get(`news?${known}`));
        else this.grown();
      } catch (error) {
        if (!(error instanceof TypeError)) this.failure = String(error.message || error);
        this.grown();
        await new Promise((done) => setTimeout(done, 1000));
      }
      if (!this.open) return;
      await new Promise((done) => setTimeout(done, Math.max(10, (this.about ? LIVE_MS : FIRST_MS) - (performance.now() - began))));
    }
  }

  take(news) {
    this.plans.push(...news.plans);
    this.missions.push(...news.missions);
    for (const [name, values] of Object.entries(news.figures)) (this.figures[name] ||= new Column()).push(values);
    for (const [round, counts] of Object.entries(news.marks)) this.marks.set(Number(round), counts);
    this.extent = news.extent;
    this.formation = news.formation;
    this.outcome = news.outcome;
    const steered = JSON.stringify(news.steer) !== JSON.stringify(this.steer);
    this.steer = news.steer;
    const grew = steered || news.last > this.last || news.open !== this.open || news.failure !== this.failure;
    this.last = news.last;
    this.open = news.open;
    this.failure = news.failure;
    if (grew) this.grown();
  }

  has(round) {
    return this.frames.has(round);
  }

  /** The robots in a round, or null while they are on their way. */
  frame(round) {
    const found = this.frames.get(round);
    if (!found) this.want(round);
    return found || null;
  }

  /** Fetch the rounds around one, if they are not here or on their way. */
  async want(round) {
    if (!this.about || round < 0 || round > this.last) return;
    const block = this.block;
    const live = this.open && round >= this.last - 2;
    let first = live ? round : Math.floor(round / block) * block;
    // At the end of a live run a slow page fetches what it missed, but no more than a block: it is to keep up.
    while (live && first > Math.max(0, round - block + 1) && !this.has(first - 1)) first -= 1;
    const name = `${first}:${live}:${this.open ? this.last : ""}`;
    if (this.asked.has(name)) return;
    this.asked.add(name);
    try {
      const got = await this.get(`frames?first=${first}&count=${block}`);
      for (const frame of got) this.frames.set(frame.r, frame);
      this.forget(round);
    } catch (error) {
      if (!(error instanceof TypeError)) this.failure = String(error.message || error);
    } finally {
      this.asked.delete(name);
    }
    this.clock.changed();
  }

  forget(round) {
    const most = Math.max(3 * this.block, Math.floor(KEPT / this.about.robots));
    if (this.frames.size <= most) return;
    const far = [...this.frames.keys()].sort((a, b) => Math.abs(b - round) - Math.abs(a - round));
    for (const number of far.slice(0, this.frames.size - most)) this.frames.delete(number);
  }
}

// The cursor over rounds that all canvases of a page share: play, pause, step, speed, and following a live run.

export class Clock {
  constructor() {
    this.cursor = 0; // rounds, with a part of the next one while playing
    this.playing = false;
    this.following = false;
    this.held = false; // the user has moved the cursor
    this.speed = 4; // rounds a second
    this.runs = [];
    this.listeners = new Set();
    this.pending = false;
    this.before = 0;
    this.began = false;
  }

  attach(run) {
    this.runs.push(run);
    run.clock = this;
    run.start(() => this.grown(run));
  }

  grown(run) {
    // A record plays from its start when it appears, unless the system asks for less motion.
    if (run.about && !run.about.live && !this.held && !this.began) {
      this.began = true;
      this.playing = !matchMedia("(prefers-reduced-motion: reduce)").matches;
    }
    if (run.fresh && this.grows(run)) {
      // A live run is followed from its first appearance on, until the user moves the cursor.
      this.following = !this.held;
      run.fresh = false;
    }
    if (this.following) this.cursor = this.last;
    if (!this.runs.some((one) => one.open)) this.following = false;
    this.changed();
  }

  /** Whether a run goes on; a record that is still being read is open, and does not. */
  grows(run) {
    return run.open && run.about && run.about.live;
  }

  get last() {
    return Math.max(0, ...this.runs.map((run) => run.last));
  }

  get round() {
    return Math.min(this.last, Math.floor(this.cursor + 1e-6));
  }

  get part() {
    return this.cursor >= this.last ? 0 : this.cursor - this.round;
  }

  listen(listener) {
    this.listeners.add(listener);
    this.changed(); // a listener hears of earlier changes too
  }

  changed() {
    if (this.pending) return;
    this.pending = true;
    requestAnimationFrame((now) => {
      this.pending = false;
      if (this.playing) this.advance(now);
      for (const listener of this.listeners) listener();
      if (this.playing) this.changed();
    });
  }

  advance(now) {
    const waiting = this.runs.some((run) => !run.has(Math.min(run.last, this.round + 1)));
    if (this.before && !waiting) {
      this.cursor += (this.speed * Math.min(250, now - this.before)) / 1000;
    }
    this.before = now;
    if (this.cursor >= this.last) {
      this.cursor = this.last;
      this.following = this.runs.some(this.grows);
      this.playing = !this.following && this.runs.some((run) => run.open); // it is still being read
    }
  }

  seek(round) {
    this.following = false;
    this.held = true;
    this.cursor = Math.max(0, Math.min(this.last, round));
    this.changed();
  }

  step(by) {
    this.playing = false;
    this.seek(this.round + by);
  }

  toggle() {
    if (this.playing || this.following) {
      this.playing = this.following = false;
      this.held = true;
    } else {
      if (this.cursor >= this.last && !this.runs.some((run) => run.open)) this.cursor = 0;
      this.playing = true;
      this.before = 0;
    }
    this.changed();
  }

  live() {
    this.playing = false;
    this.began = true; // a record that is still being read does not play from its start any more
    this.following = this.runs.some((run) => run.open); // its end is known once it has been read
    this.held = false;
    this.cursor = this.last;
    this.changed();
  }
}

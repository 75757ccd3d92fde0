// The cursor over rounds that all parts of a page share: play, pause, step, speed, and following a live run.

export class Clock {
  constructor() {
    this.cursor = 0; // rounds, with a part of the next one while playing
    this.playing = false;
    this.following = false;
    this.held = false; // somebody has taken the cursor
    this.speed = 4; // rounds a second
    this.reels = [];
    this.listeners = new Set();
    this.pending = false;
    this.before = 0;
  }

  attach(reel) {
    this.reels.push(reel);
    reel.clock = this;
    reel.start(() => this.grown(reel));
  }

  grown(reel) {
    if (reel.fresh && this.grows(reel)) {
      // A live run is followed from its first appearance on, until somebody takes the cursor.
      this.following = !this.held;
      reel.fresh = false;
    }
    if (this.following) this.cursor = this.last;
    if (!this.reels.some((one) => one.open)) this.following = false;
    this.changed();
  }

  /** Whether a run goes on; a record that is still being read is open, and does not. */
  grows(reel) {
    return reel.open && reel.about && reel.about.live;
  }

  get last() {
    return Math.max(0, ...this.reels.map((reel) => reel.last));
  }

  get round() {
    return Math.min(this.last, Math.floor(this.cursor + 1e-6));
  }

  get part() {
    return this.cursor >= this.last ? 0 : this.cursor - this.round;
  }

  listen(listener) {
    this.listeners.add(listener);
    this.changed(); // what came before it listened, it is told too
    return () => this.listeners.delete(listener);
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
    const waiting = this.reels.some((reel) => !reel.has(Math.min(reel.last, this.round + 1)));
    if (this.before && !waiting) {
      this.cursor += (this.speed * Math.min(250, now - this.before)) / 1000;
    }
    this.before = now;
    if (this.cursor >= this.last) {
      this.cursor = this.last;
      this.following = this.reels.some(this.grows);
      this.playing = !this.following && this.reels.some((reel) => reel.open); // it is still being read
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
      if (this.cursor >= this.last && !this.reels.some((reel) => reel.open)) this.cursor = 0;
      this.playing = true;
      this.before = 0;
    }
    this.changed();
  }

  live() {
    this.playing = false;
    this.following = this.reels.some(this.grows);
    this.held = false;
    this.cursor = this.last;
    this.changed();
  }
}

// Which part of the world an arena shows, from where, and how the pointer and the keys move it.

const EDGE = 18; // pixels around what is shown
const RULER = 22; // pixels below it, for the length to compare with
const ROOM = 0.06; // of the team's extent, around it
const FAR = 1.3; // diagonals of the arena between the eye and the middle: perspective that does not distort much
const ORBIT = [-30, 28]; // degrees: turned about the vertical, and looked down

/** Arenas that are shown side by side share what is chosen: both have one scale. */
export function choices() {
  return { own: null, fitted: null, look: [...ORBIT], fits: new Map() };
}

export class View {
  constructor(surface, redraw, chosen = choices()) {
    this.surface = surface;
    this.redraw = redraw;
    this.chosen = chosen; // `own` is a centre and pixels a unit, null fits `fitted`; `look` two angles, or "top" or "side"
    this.center = [0, 0];
    this.scale = 0;
    this.camera = null;
    this.pointers = new Map();
  }

  /** Fit the formation of the last round, the whole way of the team, or the arena. */
  fit(what) {
    this.chosen.fitted = what;
    this.chosen.own = null;
    this.redraw();
  }

  /** Look at space from "top", from the "side", or from two angles [degrees]; without any, from the first ones. */
  look(from = [...ORBIT]) {
    this.chosen.look = from;
    this.chosen.own = null;
    this.redraw();
  }

  turn(right, up) {
    if (!this.camera) return;
    const { look } = this.chosen;
    const [yaw, pitch] = look === "top" ? [0, 90] : look === "side" ? [0, 0] : look;
    this.chosen.look = [(yaw + right) % 360, Math.max(-5, Math.min(90, pitch + up))];
    this.redraw();
  }

  /** What is chosen, as a short text for an address; nothing where nothing is. */
  get code() {
    const { own, fitted, look } = this.chosen;
    const tidy = (numbers) => numbers.map((one) => Number(one.toPrecision(5))).join();
    const from = !this.camera || String(look) === String(ORBIT) ? [] : [typeof look === "string" ? look : `turn,${tidy(look)}`];
    const what = own ? [tidy([...own.center, own.span || this.least / own.scale])] : fitted ? [fitted] : [];
    return [...from, ...what].join(";");
  }

  /** Take up such a text; what it does not say is as at first. */
  take(code) {
    Object.assign(this.chosen, choices());
    for (const part of code.split(";")) {
      const numbers = part.replace("turn,", "").split(",").map(Number);
      const good = numbers.every((one) => Number.isFinite(one) && Math.abs(one) < 1e6);
      if (part === "top" || part === "side") this.chosen.look = part;
      else if (["formation", "way", "arena"].includes(part)) this.chosen.fitted = part;
      else if (good && part.startsWith("turn,") && numbers.length === 2) this.chosen.look = numbers;
      else if (good && numbers.length === 3 && numbers[2] > 0) this.chosen.own = { center: numbers.slice(0, 2), span: numbers[2] };
    }
    this.redraw();
  }

  get least() {
    return Math.min(this.surface.width, this.surface.height);
  }

  /** `extents` are boxes around `formation`, `way` and `team`, which is followed in space; `robot` is room for one robot [units]. */
  place(arena, extents, robot) {
    this.camera = arena[0].length > 2 ? eye(arena, this.chosen.look) : null;
    const { own, fitted } = this.chosen;
    if (own) {
      if (own.span) own.scale = this.least / own.span;
      delete own.span;
      this.center = own.center;
      this.scale = own.scale;
      return;
    }
    const extent = extents[fitted || (this.camera ? "team" : "way")];
    const half = arena[0].length;
    let [low, high] = arena;
    if (extent && extent.length) {
      const room = Math.max(robot, ROOM * Math.max(extent[half] - extent[0], extent[half + 1] - extent[1]));
      [low, high] = [extent.slice(0, half).map((one) => one - room), extent.slice(half).map((one) => one + room)];
      if (this.camera) low[2] = Math.min(low[2], Math.max(arena[0][2], 2 * low[2] - high[2])); // the ground is seen where it is near
    }
    const seen = corners(low, high).map((corner) => this.plane(corner));
    const [left, right, bottom, top] = [0, 1].flatMap((axis) => [Math.min(...seen.map((at) => at[axis])), Math.max(...seen.map((at) => at[axis]))]);
    const { width, height } = this.surface;
    const fit = Math.min((width - 2 * EDGE) / (right - left), (height - 2 * EDGE - RULER) / (top - bottom));
    const told = this.chosen.fits.get(this) !== fit; // a banner that grows leaves less room to one of two arenas
    this.scale = Math.min(...this.chosen.fits.set(this, fit).values());
    if (told) this.redraw();
    this.center = [(left + right) / 2, (bottom + top) / 2 - RULER / 2 / this.scale];
  }

  /** A place in the plane of the picture [units], and in space by how much what is there is drawn larger. */
  plane([x, y, z = 0]) {
    const { camera } = this;
    if (!camera || camera.flat === "top") return [x, y, 1];
    if (camera.flat) return [x, z, 1];
    const [dx, dy, dz] = [x - camera.middle[0], y - camera.middle[1], z - camera.middle[2]];
    const away = camera.cos * dy - camera.sin * dx;
    const larger = camera.far / Math.max(0.1 * camera.far, camera.far + away * camera.level - dz * camera.down);
    return [larger * (camera.cos * dx + camera.sin * dy), larger * (dz * camera.level + away * camera.down), larger];
  }

  pixel(at) {
    const { width, height } = this.surface;
    const [x, y, larger] = this.plane(at);
    return [width / 2 + (x - this.center[0]) * this.scale, height / 2 - (y - this.center[1]) * this.scale, larger];
  }

  point(x, y) {
    const { width, height } = this.surface;
    return [this.center[0] + (x - width / 2) / this.scale, this.center[1] - (y - height / 2) / this.scale];
  }

  /** What is chosen from now on: centre and scale of this picture, at first. */
  get own() {
    return this.chosen.own ||= { center: [...this.center], scale: this.scale };
  }

  pan(x, y) {
    if (!this.scale) return;
    this.own.center[0] -= x / this.scale;
    this.own.center[1] += y / this.scale;
    this.redraw();
  }

  zoom(factor, x = this.surface.width / 2, y = this.surface.height / 2) {
    if (!this.scale) return;
    const at = this.point(x, y);
    const { own } = this;
    this.scale = own.scale = Math.max(0.02, Math.min(400, this.scale * factor));
    this.center = own.center = [at[0] - (x - this.surface.width / 2) / own.scale, at[1] + (y - this.surface.height / 2) / own.scale];
    this.redraw();
  }

  /** Wheel, fingers and drags move the picture; a click that does not move is a pick, other moves hover. */
  listen(pick, hover) {
    const { canvas } = this.surface;
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY * 0.0015), event.offsetX, event.offsetY);
    }, { passive: false });
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, [event.offsetX, event.offsetY]);
      this.moved = this.pointers.size > 1;
      this.began = [event.offsetX, event.offsetY];
    });
    canvas.addEventListener("pointermove", (event) => {
      if (this.pointers.has(event.pointerId)) this.drag(event);
      else hover(event);
    });
    for (const name of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(name, (event) => {
        this.pointers.delete(event.pointerId);
        if (name === "pointerup" && !this.moved) pick(event);
      });
    }
    canvas.addEventListener("dblclick", () => this.fit(this.chosen.fitted));
    canvas.addEventListener("contextmenu", (event) => { if (this.camera) event.preventDefault(); }); // that button pans
  }

  drag(event) {
    const before = this.pointers.get(event.pointerId);
    if (!this.scale) return;
    const here = [event.offsetX, event.offsetY];
    if (this.pointers.size === 2) {
      const [other] = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
      const factor = Math.hypot(here[0] - other[0], here[1] - other[1])
        / Math.max(1, Math.hypot(before[0] - other[0], before[1] - other[1]));
      this.zoom(factor, (here[0] + other[0]) / 2, (here[1] + other[1]) / 2);
    }
    if (this.moved || Math.hypot(here[0] - this.began[0], here[1] - this.began[1]) > 4) {
      this.moved = true;
      const share = this.pointers.size;
      const [right, down] = [(here[0] - before[0]) / share, (here[1] - before[1]) / share];
      // In space one finger or button turns the picture; two fingers, the other button, or Shift move it.
      if (this.camera && !this.camera.flat && share === 1 && !event.shiftKey && !(event.buttons & 2)) this.turn(0.4 * right, 0.4 * down);
      else this.pan(right, down);
    }
    this.pointers.set(event.pointerId, here);
  }
}

/** The eye on an arena in space. */
function eye([low, high], look) {
  if (typeof look === "string") return { flat: look };
  const [yaw, pitch] = look.map((degrees) => (degrees * Math.PI) / 180);
  return { middle: low.map((one, axis) => (one + high[axis]) / 2), far: FAR * Math.hypot(...low.map((one, axis) => high[axis] - one)),
    cos: Math.cos(yaw), sin: Math.sin(yaw), level: Math.cos(pitch), down: Math.sin(pitch) };
}

/** The corners of a box between two of them. */
export function corners(low, high) {
  return low.reduce((found, one, axis) => found.flatMap((corner) => [[...corner, one], [...corner, high[axis]]]), [[]]);
}

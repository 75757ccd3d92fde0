// Which part of the world an arena shows, and how the pointer and the keys move it.

const EDGE = 18; // pixels around what is shown
const RULER = 22; // pixels below it, for the length to compare with
const ROOM = 0.06; // of the team's extent, around it

export class View {
  constructor(surface, redraw) {
    this.surface = surface;
    this.redraw = redraw;
    this.own = null; // centre and pixels a unit that were chosen; null fits
    this.fitted = "way";
    this.center = [0, 0];
    this.scale = 0;
    this.pointers = new Map();
  }

  /** Fit the formation of the last round, the whole way of the team, or the arena. */
  fit(what) {
    this.fitted = what;
    this.own = null;
    this.redraw();
  }

  /** `extents` are those of `formation` and `way`; `robot` is room for one robot [units]. */
  place(arena, extents, robot) {
    if (this.own) {
      this.center = this.own.center;
      this.scale = this.own.scale;
      return;
    }
    let [left, bottom, right, top] = [...arena[0], ...arena[1]];
    const extent = extents[this.fitted];
    if (extent && extent.length) {
      const room = Math.max(robot, ROOM * Math.max(extent[2] - extent[0], extent[3] - extent[1]));
      [left, bottom, right, top] = [extent[0] - room, extent[1] - room, extent[2] + room, extent[3] + room];
    }
    const { width, height } = this.surface;
    this.scale = Math.min((width - 2 * EDGE) / (right - left), (height - 2 * EDGE - RULER) / (top - bottom));
    this.center = [(left + right) / 2, (bottom + top) / 2 - RULER / 2 / this.scale];
  }

  pixel([x, y]) {
    const { width, height } = this.surface;
    return [width / 2 + (x - this.center[0]) * this.scale, height / 2 - (y - this.center[1]) * this.scale];
  }

  point(x, y) {
    const { width, height } = this.surface;
    return [this.center[0] + (x - width / 2) / this.scale, this.center[1] - (y - height / 2) / this.scale];
  }

  pan(x, y) {
    if (!this.scale) return;
    this.own ||= { center: [...this.center], scale: this.scale };
    this.own.center[0] -= x / this.scale;
    this.own.center[1] += y / this.scale;
    this.redraw();
  }

  zoom(factor, x = this.surface.width / 2, y = this.surface.height / 2) {
    if (!this.scale) return;
    const at = this.point(x, y);
    this.own ||= { center: [...this.center], scale: this.scale };
    this.own.scale = Math.max(0.02, Math.min(400, this.own.scale * factor));
    this.own.center = [
      at[0] - (x - this.surface.width / 2) / this.own.scale,
      at[1] + (y - this.surface.height / 2) / this.own.scale,
    ];
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
    canvas.addEventListener("dblclick", () => this.fit(this.fitted));
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
      this.pan((here[0] - before[0]) / share, (here[1] - before[1]) / share);
    }
    this.pointers.set(event.pointerId, here);
  }
}

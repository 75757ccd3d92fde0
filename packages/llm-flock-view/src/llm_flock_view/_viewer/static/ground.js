// The arena before a start: robots and the centre of the formation are dragged there, or moved by arrow keys.
import { button, h, order } from "llm-flock-viewer/dom.js";
import { View } from "llm-flock-viewer/arena_view.js";
import { FONT, Surface, theme } from "llm-flock-viewer/surface.js";

const WAIT_MS = 300; // between a change of the form and the picture of it
const CENTER = -1; // stands for the centre among the robots
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }; // units

export class Ground {
  /** `asked` gives what the form holds; `center` is its input for the centre. */
  constructor(asked, center) {
    // `moved` are starts that were dragged, or null: those that the rule of the form draws.
    Object.assign(this, { asked, input: center, moved: null, before: [], chosen: CENTER });
    const part = h("div", { class: "flock-part flock-ground" });
    this.surface = new Surface(part, "Map before the start: drag what is on it, or choose with [ and ] and move with the arrow keys", () => this.draw());
    this.view = new View(this.surface, () => this.draw());
    this.surface.drag((event) => this.grasp(event), (event) => this.move(this.view.point(event.offsetX, event.offsetY)));
    this.surface.canvas.addEventListener("pointerup", () => this.ask());
    this.surface.canvas.addEventListener("keydown", (event) => this.key(event));
    this.undo = Object.assign(button("Undo", () => this.back()), { disabled: true });
    this.element = h("div", {}, part, h("div", { class: "flock-row" }, this.undo,
      h("span", { class: "flock-hint", text: "Drag robots and the cross at the centre to where they are to start. Rings are the places of the formation." })));
    this.ask();
  }

  get center() {
    const numbers = this.input.value.split(",").map(Number);
    return numbers.length === 2 && numbers.every(Number.isFinite) ? numbers : this.scene.center;
  }

  get starts() {
    return this.moved || this.scene.starts;
  }

  /** Ask for the picture once the form is at rest; `anew` forgets what was dragged. */
  ask(anew = false) {
    if (anew) [this.moved, this.before, this.undo.disabled] = [null, [], true];
    clearTimeout(this.due);
    this.due = setTimeout(async () => {
      const found = await order({ order: "preview", fields: { ...this.asked(), start_positions: null } });
      if (found.error) return; // the start says what is wrong
      this.scene = found;
      if (this.moved && this.moved.length !== found.starts.length) this.ask(true);
      this.draw();
    }, WAIT_MS);
  }

  back() {
    [this.moved, this.input.value] = this.before.pop();
    this.undo.disabled = !this.before.length;
    this.draw();
    this.ask();
  }

  grasp(event) {
    if (!this.scene) return;
    const far = ([x, y]) => Math.hypot(x - event.offsetX, y - event.offsetY);
    const all = [this.center, ...this.starts].map((at) => far(this.view.pixel(at)));
    const nearest = all.indexOf(Math.min(...all));
    this.chosen = all[nearest] < 24 ? nearest - 1 : null;
    this.keep();
  }

  /** Remember what is there, for the undo, before the chosen one moves. */
  keep() {
    if (this.chosen !== null) this.before.push([this.moved && [...this.moved], this.input.value]);
    this.undo.disabled = !this.before.length;
    this.draw();
  }

  key(event) {
    const [by, turn] = [ARROWS[event.key], { "[": -1, "]": 1 }[event.key]];
    if (!this.scene || (!by && !turn)) return;
    event.preventDefault();
    const all = [this.center, ...this.starts];
    this.chosen = (((this.chosen ?? CENTER) + 1 + (turn || 0) + all.length) % all.length) - 1;
    if (turn) return this.draw();
    this.keep();
    this.move(all[this.chosen + 1].map((one, axis) => one + by[axis]));
    return this.ask();
  }

  move(to) {
    if (!this.scene || this.chosen === null) return;
    const [low, high] = this.scene.arena;
    const at = to.map((one, axis) => Number(Math.max(low[axis], Math.min(high[axis], one)).toFixed(1)));
    if (this.chosen === CENTER) this.input.value = at.join(", ");
    else this.moved = this.starts.with(this.chosen, at);
    this.draw();
  }

  draw() {
    const { surface, scene, view } = this;
    if (!surface.width || !scene) return;
    const { pen } = surface;
    const { soft, accent, paper } = theme();
    surface.clear();
    view.place(scene.arena, {}, scene.safe);
    const [low, high] = scene.arena.map((corner) => view.pixel(corner));
    pen.strokeStyle = soft;
    pen.lineWidth = 1;
    pen.strokeRect(low[0], high[1], high[0] - low[0], low[1] - high[1]);
    const shift = this.center.map((one, axis) => one - scene.center[axis]);
    for (const [x, y] of scene.places) {
      surface.circle(view.pixel([x + shift[0], y + shift[1]]), 9);
      pen.stroke();
    }
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    pen.font = `600 11px ${FONT}`;
    this.starts.forEach((at, robot) => {
      surface.circle(view.pixel(at), robot === this.chosen ? 12 : 9);
      pen.fillStyle = accent;
      pen.fill();
      pen.fillStyle = paper;
      pen.fillText(String(robot), ...view.pixel(at).slice(0, 2));
    });
    const [x, y] = view.pixel(this.center);
    pen.strokeStyle = this.chosen === CENTER ? accent : soft;
    pen.lineWidth = 3;
    surface.line([x - 10, y], [x + 10, y]);
    surface.line([x, y - 10], [x, y + 10]);
    surface.canvas.dataset.starts = this.starts.map((at) => at.map((one) => one.toFixed(1)).join()).join(" ");
  }
}

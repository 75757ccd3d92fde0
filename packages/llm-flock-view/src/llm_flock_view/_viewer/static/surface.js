// A canvas as sharp as the screen, redrawn when its size or the page's colours change.

const DARK = { ink: "#e8eaed", soft: "#a9afb8", faint: "#5b6470", grid: "#2b323b", paper: "#12161b",
  warn: "#ff8b4d", accent: "#5ab0ee", none: "#2b323b", danger: "#ff6b6b", bent: "#ffb000", good: "#56d364" };
const LIGHT = { ink: "#1d232a", soft: "#56606b", faint: "#9aa3ad", grid: "#e3e6ea", paper: "#ffffff",
  warn: "#b93a08", accent: "#0063a8", none: "#ffffff", danger: "#c81e1e", bent: "#ffb000", good: "#1a6f33" };

export const FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif";

function isDark() {
  return document.body.classList.contains("body--dark");
}

export function theme() {
  return isDark() ? DARK : LIGHT;
}

/** How the runs of a page are told apart: by a colour and by a stroke. */
export function side(k) {
  return { ink: [theme().accent, theme().warn][k % 2], stroke: [[], [7, 4]][k % 2] };
}

/** A plan's look; without one a white disk with a dotted rim. */
export function look(run, number) {
  if (number < 0) return { name: "", fill: theme().none, line: theme().soft, ink: theme().ink, rim: ":" };
  const plan = run.plans[number] || { name: "?", fill: "#7f7f7f", line: "#7f7f7f", ink: "#ffffff", rim: "-" };
  return isDark() ? { ...plan, line: plan.fill } : plan;
}

const DASHES = { "-": [], "--": [5, 3], "-.": [6, 3, 1.5, 3], ":": [1.5, 2.5] };

export function dash(rim) {
  return DASHES[rim] || [];
}

export class Surface {
  constructor(element, label, redraw) {
    this.redraw = redraw;
    this.canvas = document.createElement("canvas");
    this.canvas.className = "flock-canvas";
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", label);
    element.append(this.canvas);
    this.pen = this.canvas.getContext("2d");
    new ResizeObserver(() => this.fit()).observe(element);
    new MutationObserver(() => this.redraw()).observe(document.body, { attributes: true, attributeFilter: ["class"] });
    this.element = element;
    this.width = this.height = 0;
  }

  fit() {
    const ratio = Math.min(3, window.devicePixelRatio || 1);
    const { clientWidth, clientHeight } = this.element;
    if (!clientWidth || !clientHeight) return;
    this.width = clientWidth;
    this.height = clientHeight;
    this.canvas.width = Math.round(clientWidth * ratio);
    this.canvas.height = Math.round(clientHeight * ratio);
    this.pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.redraw();
  }

  clear() {
    this.pen.clearRect(0, 0, this.width, this.height);
  }

  /** A line; one with `dashes` leaves the pen without any. */
  line([x0, y0], [x1, y1], dashes = null) {
    if (dashes) this.pen.setLineDash(dashes);
    this.pen.beginPath();
    this.pen.moveTo(x0, y0);
    this.pen.lineTo(x1, y1);
    this.pen.stroke();
    if (dashes) this.pen.setLineDash([]);
  }

  /** Begin a path along a circle, to be filled or stroked. */
  circle([x, y], radius) {
    this.pen.beginPath();
    this.pen.arc(x, y, radius, 0, 2 * Math.PI);
  }

  /** Begin a closed path through corners, to be filled or stroked. */
  polygon(corners) {
    this.pen.beginPath();
    corners.forEach((corner, k) => this.pen[k ? "lineTo" : "moveTo"](...corner));
    this.pen.closePath();
  }

  /** Listen to the pointer: where it goes down, is dragged to, and hovers. */
  drag(down, drag, hover = () => {}) {
    const { canvas } = this;
    let dragging = false;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      dragging = true;
      down(event);
    });
    canvas.addEventListener("pointermove", (event) => (dragging ? drag : hover)(event));
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => { dragging = false; });
  }

  /** Words beside the pointer; null takes them away, as does Escape. */
  tip(text, x = 0, y = 0) {
    if (!this.words && text) {
      this.words = document.createElement("div");
      this.words.className = "flock-tip";
      this.words.setAttribute("role", "tooltip");
      this.element.append(this.words);
      document.addEventListener("keydown", (event) => { if (event.key === "Escape") this.tip(null); });
    }
    if (!this.words) return;
    this.words.hidden = !text;
    if (!text) return;
    this.words.textContent = text;
    const wide = this.words.offsetWidth;
    this.words.style.left = `${Math.max(2, Math.min(this.width - wide - 2, x + 12))}px`;
    this.words.style.top = `${y > this.height / 2 ? y - this.words.offsetHeight - 8 : y + 18}px`;
  }
}

// A canvas as sharp as the screen, redrawn when its size or the page's colours change.

const DARK = { ink: "#e8eaed", soft: "#a9afb8", faint: "#5b6470", grid: "#2b323b", paper: "#12161b", panel: "#1b2129",
  warn: "#ff8b4d", accent: "#5ab0ee", none: "#2b323b" };
const LIGHT = { ink: "#1d232a", soft: "#56606b", faint: "#9aa3ad", grid: "#e3e6ea", paper: "#ffffff", panel: "#f6f7f9",
  warn: "#c2410c", accent: "#0063a8", none: "#ffffff" };

export const FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif";

export function isDark() {
  return document.body.classList.contains("body--dark");
}

export function theme() {
  return isDark() ? DARK : LIGHT;
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
  constructor(element, label) {
    this.canvas = document.createElement("canvas");
    this.canvas.className = "flock-canvas";
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", label);
    element.append(this.canvas);
    this.pen = this.canvas.getContext("2d");
    this.sizes = new ResizeObserver(() => this.fit());
    this.sizes.observe(element);
    this.classes = new MutationObserver(() => this.redraw());
    this.classes.observe(document.body, { attributes: true, attributeFilter: ["class"] });
    this.element = element;
    this.width = this.height = 0;
    this.redraw = () => {};
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

  close() {
    this.sizes.disconnect();
    this.classes.disconnect();
    this.canvas.remove();
  }
}

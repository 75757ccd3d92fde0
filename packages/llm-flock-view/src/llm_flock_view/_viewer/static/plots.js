// Plots over rounds, linked to the cursor. Runs are told apart by colour and stroke, and a line says why it ends.
import { FONT, Surface, side, theme } from "llm-flock-viewer/surface.js";

const LEFT = 52;
const RIGHT = 14;
const LEAST = 150; // pixels that a chart needs to be read
const LINE = 16; // pixels of a line of the legend

export class Plots {
  constructor(element, runs, clock, options) {
    this.runs = runs;
    this.clock = clock;
    this.charts = options.charts;
    this.names = options.names;
    this.note = options.note;
    element.style.minHeight = `${this.charts.length * (LEAST + (runs.length > 1 ? LINE : 0))}px`;
    const titles = this.charts.map((chart) => chart.title).join(", ");
    this.surface = new Surface(element, `Plots over rounds: ${titles}`, () => this.draw());
    clock.listen(() => this.draw());
    const seek = (event) => {
      clock.playing = false;
      const share = (event.offsetX - LEFT) / Math.max(1, this.surface.width - LEFT - RIGHT);
      clock.seek(Math.round(Math.max(0, Math.min(1, share)) * Math.max(1, clock.last)));
    };
    this.surface.drag(seek, seek);
  }

  draw() {
    const { width, height } = this.surface;
    if (!width) return;
    this.surface.clear();
    const each = height / this.charts.length;
    this.charts.forEach((chart, k) => this.chart(chart, k * each, each));
  }

  /** The lines of a chart: of one run they differ by colour, of two by the runs' colours and the figures' strokes. */
  series(chart) {
    const pair = this.runs.length > 1;
    return chart.series.flatMap((one, s) => this.runs.map((run, r) => ({
      run,
      r,
      values: run.figures[one.figure]?.values || [],
      ink: pair ? side(r).ink : [theme().accent, theme().warn][s % 2],
      stroke: pair ? (s ? [2, 3] : side(r).stroke) : [[], [6, 3]][s % 2],
      name: [pair ? this.names[r] : "", one.name].filter(Boolean).join(" "),
    })));
  }

  chart(chart, top, room) {
    const { pen, width } = this.surface;
    const colours = theme();
    const series = this.series(chart);
    pen.font = `600 13px ${FONT}`;
    pen.textAlign = "left";
    pen.textBaseline = "middle";
    pen.fillStyle = colours.ink;
    pen.fillText(chart.title, 4, top + 12);
    const lines = this.legend(series, top + 12, pen.measureText(chart.title).width + 24);
    const [y0, y1] = [top + room - 20, top + 24 + lines * LINE];
    const span = Math.max(1, this.clock.last);
    const x = (round) => LEFT + (round / span) * (width - LEFT - RIGHT);
    const edge = chart.edge && this.runs[0].about ? this.runs[0].about[chart.edge] : null;
    let high = edge || 0;
    for (const one of series) for (const value of one.values) if (value > high) high = value;
    const most = edge ? Math.min(high, 6 * edge) : high;
    const step = stepOf(most, chart.whole);
    const upper = step * Math.max(1, Math.ceil(most / step - 1e-9));
    const y = (value) => y0 - (Math.min(value, upper) / upper) * (y0 - y1);
    this.frame(x, y, y0, y1, { step, top: upper, beyond: high > upper }, span);
    if (edge) {
      pen.strokeStyle = pen.fillStyle = colours.danger;
      this.surface.line([LEFT, y(edge)], [width - RIGHT, y(edge)], [4, 3]);
      pen.textAlign = "right";
      pen.fillText("safe distance", width - RIGHT - 4, y(edge) + 8);
    }
    pen.lineWidth = 1.8;
    for (const one of series) {
      this.curve(one, x, y);
      this.end(one, x, y);
    }
    pen.setLineDash([]);
    pen.strokeStyle = colours.accent;
    pen.lineWidth = 1.5;
    this.surface.line([x(this.clock.round), y0], [x(this.clock.round), y1]);
  }

  frame(x, y, y0, y1, { step, top, beyond }, span) {
    const { pen, width } = this.surface;
    pen.strokeStyle = theme().grid;
    pen.lineWidth = 1;
    pen.setLineDash([]);
    pen.strokeRect(LEFT, y1, width - LEFT - RIGHT, y0 - y1);
    pen.font = `11px ${FONT}`;
    pen.fillStyle = theme().soft;
    pen.textAlign = "right";
    for (let k = 0; k * step <= top + 1e-9 * top; k += 1) {
      const value = Number((k * step).toPrecision(12));
      if (k && value < top) this.surface.line([LEFT, y(value)], [width - RIGHT, y(value)]);
      // What is beyond the top is drawn along it.
      pen.fillText(short(value) + (beyond && value >= top - 1e-9 * top ? "+" : ""), LEFT - 4, Math.max(y1 + 4, Math.min(y0 - 3, y(value))));
    }
    pen.textAlign = "left";
    pen.fillText("0", LEFT, y0 + 9);
    pen.textAlign = "right";
    pen.fillText(`round ${span}`, x(span), y0 + 9);
  }

  /** Names and values at the cursor, above the lines; returns in how many lines below the title's. */
  legend(series, first, used) {
    const { pen, width } = this.surface;
    pen.font = `12px ${FONT}`;
    let [left, line] = [used, 0];
    for (const one of series) {
      const value = one.values[Math.min(this.clock.round, one.values.length - 1)];
      const known = value !== undefined && !Number.isNaN(value);
      const text = `${one.name ? `${one.name} ` : ""}${known ? short(value) : value === undefined ? "–" : "unknown"}`;
      const wide = pen.measureText(text).width + 40;
      if (left + wide > width - 4 && left > 4) [left, line] = [4, line + 1];
      const y = first + line * LINE;
      pen.strokeStyle = pen.fillStyle = one.ink;
      pen.lineWidth = 2;
      this.surface.line([left, y], [left + 22, y], one.stroke);
      pen.fillText(text, left + 26, y);
      left += wide;
    }
    return line;
  }

  curve(one, x, y) {
    const { pen } = this.surface;
    pen.strokeStyle = one.ink;
    pen.setLineDash(one.stroke);
    pen.beginPath();
    let down = false;
    let before = -Infinity;
    one.values.forEach((value, round) => {
      if (Number.isNaN(value)) {
        down = false;
        return;
      }
      const at = x(round);
      if (down && at - before < 0.5 && round < one.values.length - 1) return;
      before = at;
      pen[down ? "lineTo" : "moveTo"](at, y(value));
      down = true;
    });
    pen.stroke();
  }

  /** Where a line stops before the others: ✓ if its run had formed, × if not, ? if it is not known further. The words are above the plots. */
  end(one, x, y) {
    const { pen } = this.surface;
    const { run, values } = one;
    let last = values.length - 1;
    while (last >= 0 && Number.isNaN(values[last])) last -= 1;
    const value = values[last];
    const unknown = last < values.length - 1;
    if (value === undefined || (!unknown && (run.open || run.last >= this.clock.last))) return;
    if (unknown && this.note) this.note.hidden = false;
    const formed = run.outcome && run.outcome.formed;
    pen.setLineDash([]);
    pen.font = `700 13px ${FONT}`;
    pen.textAlign = "center";
    pen.fillStyle = theme().paper;
    this.surface.circle([x(last), y(value)], 7);
    pen.fill();
    pen.fillStyle = pen.strokeStyle = one.ink;
    pen.lineWidth = 1.5;
    pen.stroke();
    pen.fillText(unknown ? "?" : formed ? "✓" : "×", x(last), y(value) + 0.5);
  }
}

/** A round distance between the lines of a grid, two to four of them; `whole` for what is counted. */
function stepOf(high, whole) {
  const rough = (high > 0 ? high : 1) / 3;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((k) => k * power >= rough * (1 - 1e-9));
  return whole ? Math.max(1, step) : step;
}

function short(value) {
  if (value === 0) return "0";
  if (Math.abs(value) >= 10000) return `${Number((value / 1000).toPrecision(3))}k`;
  return String(Number(value.toPrecision(3)));
}

// Small plots over rounds, linked to the cursor. Several runs are told apart by the stroke as well as by the colour.
import { FONT, Surface, theme } from "llm-flock-viewer/surface.js";

const LEFT = 52;
const RIGHT = 12;
const STROKES = [[], [6, 3], [2, 3]];

export class Plots {
  constructor(element, runs, clock, options) {
    this.runs = runs;
    this.clock = clock;
    this.charts = options.charts;
    this.surface = new Surface(element, `Plots over rounds: ${this.charts.map((chart) => chart.title).join(", ")}`, () => this.draw());
    this.forget = clock.listen(() => this.draw());
    const seek = (event) => {
      clock.playing = false;
      const share = (event.offsetX - LEFT) / Math.max(1, this.surface.width - LEFT - RIGHT);
      clock.seek(Math.round(Math.max(0, Math.min(1, share)) * Math.max(1, clock.last)));
    };
    this.surface.drag(seek, seek);
    this.surface.fit();
  }

  draw() {
    const { width, height } = this.surface;
    if (!width) return;
    this.surface.clear();
    const each = height / this.charts.length;
    this.charts.forEach((chart, k) => this.chart(chart, k * each, each));
  }

  chart(chart, top, room) {
    const { pen, width } = this.surface;
    const colours = theme();
    const [y0, y1] = [top + room - 14, top + 22];
    const span = Math.max(1, this.clock.last);
    const x = (round) => LEFT + (round / span) * (width - LEFT - RIGHT);
    const series = chart.series.flatMap((one, s) =>
      this.runs.map((run, r) => ({ ...one, values: run.figures[one.figure]?.values || [], stroke: s + r, run })));
    const edge = chart.edge && this.runs[0].about ? this.runs[0].about[chart.edge] : null;
    let high = edge || 0;
    for (const one of series) for (const value of one.values) if (value > high) high = value;
    if (chart.edge && edge) high = Math.min(high, 6 * edge);
    high = high > 0 ? high * 1.08 : 1;
    const y = (value) => y0 - (Math.min(value, high) / high) * (y0 - y1);
    pen.font = `600 12px ${FONT}`;
    pen.textAlign = "left";
    pen.textBaseline = "middle";
    pen.fillStyle = colours.ink;
    pen.fillText(chart.title, 4, top + 10);
    pen.strokeStyle = colours.grid;
    pen.lineWidth = 1;
    pen.setLineDash([]);
    pen.strokeRect(LEFT, y1, width - LEFT - RIGHT, y0 - y1);
    pen.font = `11px ${FONT}`;
    pen.fillStyle = colours.soft;
    pen.textAlign = "right";
    pen.fillText(short(high), LEFT - 4, y1 + 4);
    pen.fillText("0", LEFT - 4, y0 - 3);
    if (edge) {
      pen.strokeStyle = colours.warn;
      pen.setLineDash([4, 3]);
      this.surface.line([LEFT, y(edge)], [width - RIGHT, y(edge)]);
    }
    const inks = [colours.accent, colours.warn, colours.ink];
    pen.lineWidth = 1.8;
    for (const one of series) this.curve(one, x, y, inks[one.stroke % 3]);
    pen.setLineDash([]);
    this.cursor(chart, series, x, y0, y1, top, inks);
  }

  curve(one, x, y, ink) {
    const { pen } = this.surface;
    pen.strokeStyle = ink;
    pen.setLineDash(STROKES[one.stroke % 3]);
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

  cursor(chart, series, x, y0, y1, top, inks) {
    const { pen, width } = this.surface;
    const round = this.clock.round;
    pen.strokeStyle = theme().accent;
    pen.lineWidth = 1.5;
    this.surface.line([x(round), y0], [x(round), y1]);
    let right = width - RIGHT;
    pen.textAlign = "right";
    for (const one of [...series].reverse()) {
      const value = one.values[Math.min(round, one.values.length - 1)];
      const text = `${one.name ? `${one.name} ` : ""}${value === undefined || Number.isNaN(value) ? "–" : short(value)}`;
      pen.fillStyle = inks[one.stroke % 3];
      pen.fillText(text, right, top + 10);
      const wide = pen.measureText(text).width;
      pen.strokeStyle = inks[one.stroke % 3];
      pen.lineWidth = 2;
      pen.setLineDash(STROKES[one.stroke % 3]);
      this.surface.line([right - wide - 20, top + 10], [right - wide - 5, top + 10]);
      pen.setLineDash([]);
      right -= wide + 30;
    }
  }

  close() {
    this.forget();
    this.surface.close();
  }
}

function short(value) {
  if (value === 0) return "0";
  if (Math.abs(value) >= 10000) return `${Number((value / 1000).toPrecision(3))}k`;
  return String(Number(value.toPrecision(3)));
}

/* Charts on a canvas, and charts over time that are zoomed and moved together. */
const source = document.getElementById("evidence");
const evidence = source ? JSON.parse(source.textContent)
  : { recordings: {}, series: [], residuals: [], units: {} };
const MODELS = evidence.models || [["measured", "measured"], ["given", "as given"],
  ["recalibrated", "re-calibrated"], ["explained", "explained"], ...(evidence.rivals || [])];
const LEFT = 62, RIGHT = 10, TOP = 8, BOTTOM = 24;
const shown = { measured: true, given: false, recalibrated: true, explained: true };
for (const [key] of evidence.rivals || []) shown[key] = false;
const root = document.documentElement;

const floats = (packed) => {
  const raw = atob(packed.data), bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return packed.wide ? new Float64Array(bytes.buffer) : new Float32Array(bytes.buffer);
};
const unpack = (row) => {
  for (const [key, value] of Object.entries(row)) {
    if (value && value.data !== undefined) row[key] = floats(value);
    else if (key === "variables" || key === "inputs") unpack(value);
  }
  return row;
};
[...Object.values(evidence.recordings), ...evidence.series, ...evidence.residuals].forEach(unpack);
for (const row of evidence.series) {
  const { time, inputs } = evidence.recordings[row.recording];
  const beside = evidence.series.filter((s) => s.recording === row.recording);
  row.time = time;
  row.variables = { ...Object.fromEntries(beside.map((s) => [s.output, s.measured])), ...inputs };
}

const make = (tag, attributes = {}, ...children) => {
  const node = document.createElement(tag);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) node.addEventListener(key.slice(2), value);
    else node.setAttribute(key, value);
  }
  node.append(...children);
  return node;
};
const colour = (name) => getComputedStyle(root).getPropertyValue(`--${name}`).trim();
const hue = { measured: "measured", given: "given", recalibrated: "before", explained: "after",
  rival0: "rival", rival1: "rival", rival2: "rival" };
const digits = (x) => (Number.isFinite(x) ? String(Number(x.toPrecision(4))) : "–");
const named = (name, unit) => (unit ? `${name} in ${unit}` : name);

/* One chart on a canvas. `lines` are {x, y, key, dots}; the y-range is that of what is in view. */
class Chart {
  constructor(height, label) {
    this.height = height;
    this.label = label;
    this.lines = [];
    this.canvas = make("canvas", { role: "img", "aria-label": label, tabindex: "0" });
    this.at = null;
  }

  visible() { return this.lines.filter((line) => shown[line.key] !== false); }

  range() {
    let low = Infinity, high = -Infinity;
    for (const { x, y } of this.visible()) {
      for (let i = 0; i < y.length; i++) {
        if (x[i] >= this.span[0] && x[i] <= this.span[1] && Number.isFinite(y[i])) {
          low = Math.min(low, y[i]);
          high = Math.max(high, y[i]);
        }
      }
    }
    if (this.most && high - low > this.most) { // a run that flies off hides all the rest
      low = Math.max(low, this.centre - this.most);
      high = Math.min(high, this.centre + this.most);
    }
    if (!(high > low)) { low = (Number.isFinite(low) ? low : 0) - 1; high = low + 2; }
    const pad = 0.06 * (high - low);
    return [low - pad, high + pad];
  }

  draw(span) {
    this.span = span;
    const width = this.canvas.parentNode ? this.canvas.parentNode.clientWidth : 0;
    if (!width) return;
    const ratio = window.devicePixelRatio || 1, pen = this.canvas.getContext("2d");
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(this.height * ratio);
    this.canvas.style.height = `${this.height}px`;
    pen.scale(ratio, ratio);
    const [low, high] = this.range(), right = width - RIGHT, bottom = this.height - BOTTOM;
    this.toX = (v) => LEFT + ((v - span[0]) / (span[1] - span[0])) * (right - LEFT);
    this.fromX = (p) => span[0] + ((p - LEFT) / (right - LEFT)) * (span[1] - span[0]);
    const toY = (v) => bottom - ((v - low) / (high - low)) * (bottom - TOP);
    pen.font = "11px system-ui, sans-serif";
    pen.fillStyle = colour("soft");
    pen.strokeStyle = colour("line");
    pen.lineWidth = 1;
    pen.textAlign = "right";
    for (const v of ticks(low, high, Math.max(2, this.height / 40))) {
      pen.beginPath();
      pen.moveTo(LEFT, toY(v));
      pen.lineTo(right, toY(v));
      pen.stroke();
      pen.fillText(digits(v), LEFT - 5, toY(v) + 4);
    }
    pen.textAlign = "center";
    for (const v of ticks(span[0], span[1], width / 90)) {
      pen.fillText(digits(v), this.toX(v), this.height - 7);
    }
    pen.save();
    pen.translate(11, (TOP + bottom) / 2);
    pen.rotate(-Math.PI / 2);
    pen.fillText(this.label, 0, 0, bottom - TOP + 10);
    pen.restore();
    pen.save();
    pen.beginPath();
    pen.rect(LEFT, TOP, right - LEFT, bottom - TOP);
    pen.clip();
    for (const line of this.visible()) this.trace(pen, line, toY);
    if (this.at !== null) {
      pen.strokeStyle = colour("soft");
      pen.beginPath();
      pen.moveTo(this.toX(this.at), TOP);
      pen.lineTo(this.toX(this.at), bottom);
      pen.stroke();
    }
    if (this.band) {
      pen.fillStyle = colour("plus-mark");
      pen.globalAlpha = 0.5;
      const [a, b] = this.band.map(this.toX);
      pen.fillRect(Math.min(a, b), TOP, Math.abs(b - a), bottom - TOP);
    }
    pen.restore();
  }

  trace(pen, { x, y, key, dots }, toY) {
    pen.strokeStyle = pen.fillStyle = colour(hue[key] || "ink");
    pen.lineWidth = key === "measured" ? 2.4 : 1.2;
    pen.globalAlpha = dots ? 0.45 : key === "measured" ? 0.5 : 1;
    pen.beginPath();
    let broken = true;
    for (let i = 0; i < y.length; i++) {
      if (!Number.isFinite(y[i]) || !Number.isFinite(x[i])) { broken = true; continue; }
      const px = this.toX(x[i]), py = toY(y[i]);
      if (dots) pen.fillRect(px - 1.5, py - 1.5, 3, 3);
      else if (broken) pen.moveTo(px, py);
      else pen.lineTo(px, py);
      broken = false;
    }
    if (!dots) pen.stroke();
    pen.globalAlpha = 1;
  }
}

const ticks = (low, high, most) => {
  const raw = (high - low) / Math.max(most, 1), power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((k) => k * power).find((s) => s >= raw);
  const found = [];
  for (let v = Math.ceil(low / step) * step; v <= high; v += step) found.push(Math.abs(v) < step / 1e6 ? 0 : v);
  return found;
};
const nearest = (x, at) => {
  let low = 0, high = x.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (x[middle] < at) low = middle; else high = middle;
  }
  return at - x[low] < x[high] - at ? low : high;
};

/* Charts over time that are zoomed and moved together. */
class Linked {
  constructor(place, say) { this.place = place; this.say = say; this.charts = []; }

  show(charts) {
    this.charts = charts;
    this.place.replaceChildren(...charts.map((chart) => make("div", { class: "chart" }, chart.canvas)));
    const ends = charts.flatMap((c) => c.lines.map(({ x }) => [x[0], x[x.length - 1]]));
    this.whole = [Math.min(...ends.map((e) => e[0])), Math.max(...ends.map((e) => e[1]))];
    this.span = [...this.whole];
    charts.forEach((chart) => this.listen(chart));
    this.draw();
  }

  draw() { this.charts.forEach((chart) => chart.draw(this.span)); }

  to(low, high) {
    const length = Math.min(high - low, this.whole[1] - this.whole[0]);
    const start = Math.max(this.whole[0], Math.min(low, this.whole[1] - length));
    if (length > 0) this.span = [start, start + length];
    this.draw();
  }

  zoom(factor, about = (this.span[0] + this.span[1]) / 2) {
    this.to(about - (about - this.span[0]) * factor, about + (this.span[1] - about) * factor);
  }

  move(share) {
    const by = share * (this.span[1] - this.span[0]);
    this.to(this.span[0] + by, this.span[1] + by);
  }

  listen(chart) {
    const canvas = chart.canvas;
    const at = (event) => chart.fromX(event.clientX - canvas.getBoundingClientRect().left);
    let begun = null, moving = null;
    canvas.addEventListener("pointerdown", (event) => {
      if (event.pointerType === "touch") return; // a finger scrolls the page
      canvas.setPointerCapture(event.pointerId);
      if (event.shiftKey) moving = event.clientX; else begun = at(event);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (moving !== null) {
        const by = (moving - event.clientX) / (canvas.clientWidth - LEFT - RIGHT);
        moving = event.clientX;
        this.move(by);
        return;
      }
      const here = at(event);
      this.charts.forEach((c) => { c.at = here; c.band = begun === null ? null : [begun, here]; });
      this.draw();
      this.tell(here);
    });
    canvas.addEventListener("pointerup", (event) => {
      const here = at(event), from = begun;
      begun = moving = null;
      this.charts.forEach((c) => { c.band = null; });
      const pixels = from === null ? 0 : Math.abs(chart.toX(here) - chart.toX(from));
      if (pixels > 6) this.to(Math.min(from, here), Math.max(from, here)); else this.draw();
    });
    canvas.addEventListener("pointerleave", () => {
      this.charts.forEach((c) => { c.at = null; });
      this.draw();
    });
    canvas.addEventListener("dblclick", () => this.to(...this.whole));
    canvas.addEventListener("wheel", (event) => {
      if (!event.ctrlKey) return; // plain wheels scroll the page
      event.preventDefault();
      this.zoom(event.deltaY > 0 ? 1.25 : 0.8, at(event));
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const act = { ArrowLeft: () => this.move(-0.2), ArrowRight: () => this.move(0.2),
        "+": () => this.zoom(0.6), "-": () => this.zoom(1.6), 0: () => this.to(...this.whole) }[event.key];
      if (act) { event.preventDefault(); act(); }
    });
  }

  tell(here) {
    const parts = [`${digits(here)} s`];
    for (const chart of this.charts) {
      const values = chart.visible().map(({ x, y, key }) =>
        `${(MODELS.find((m) => m[0] === key) || [key, key])[1]} ${digits(y[nearest(x, here)])}`);
      if (values.length) parts.push(`${chart.label}: ${values.join(", ")}`);
    }
    this.say.textContent = parts.join(" · ");
  }
}

/* What the page does with them: recordings, residuals over any variable, hypotheses, copying. */
const difference = (a, b) => Float32Array.from(a, (v, i) => v - b[i]);
const spread = (values) => {
  let low = Infinity, high = -Infinity;
  for (const v of values) if (Number.isFinite(v)) { low = Math.min(low, v); high = Math.max(high, v); }
  return [low, high];
};

const chartsOf = (name, errors) => {
  const found = [];
  for (const row of evidence.series.filter((s) => s.recording === name)) {
    const chart = new Chart(errors ? 130 : 170, named(errors ? `error of ${row.output}` : row.output, row.unit));
    for (const [key] of MODELS) {
      if (!row[key] || (errors && key === "measured")) continue;
      chart.lines.push({ x: row.time, key, y: errors ? difference(row[key], row.measured) : row[key] });
    }
    const [low, high] = spread(row.measured);
    chart.most = 3 * (high - low);
    chart.centre = errors ? 0 : (low + high) / 2;
    found.push(chart);
  }
  for (const row of evidence.residuals.filter((r) => r.recording === name && errors)) {
    const chart = new Chart(130, named(`residual, ${row.words}`, row.unit));
    for (const key of ["recalibrated", "explained"]) chart.lines.push({ x: row.time, y: row[key], key });
    found.push(chart);
  }
  return found;
};

const choice = (words, options, change) => {
  const select = make("select", { onchange: () => change(select.value) },
    ...options.map(([value, text]) => make("option", { value }, text)));
  return [make("label", {}, `${words} `, select), select];
};

/* Residuals of every recording over a variable. */
const scatter = (place, redraws) => {
  const sources = [];
  for (const site of new Set(evidence.residuals.map((r) => r.site))) {
    const rows = evidence.residuals.filter((r) => r.site === site);
    sources.push([`residual, ${rows[0].words}`, rows, (row, key) => row[key], rows[0].unit]);
  }
  for (const output of new Set(evidence.series.map((s) => s.output))) {
    const rows = evidence.series.filter((s) => s.output === output);
    sources.push([`error of ${output}`, rows, (row, key) => row[key] && difference(row[key], row.measured), rows[0].unit]);
  }
  if (!sources.length) return;
  const chart = new Chart(300, "");
  const [over, variable] = choice("over", [], () => draw());
  const [of, what] = choice("", sources.map((s, i) => [i, s[0]]), () => fill());
  const box = make("div", { class: "chart" }, chart.canvas);
  const axis = make("p", { class: "soft axis" });
  const draw = () => {
    const [words, rows, values, unit] = sources[what.value];
    chart.lines = [];
    chart.label = named(words, unit);
    for (const row of rows) {
      const x = variable.value === "time" ? row.time : row.variables[variable.value];
      for (const [key] of MODELS.slice(1)) {
        const y = values(row, key);
        if (x && y) chart.lines.push({ x, y, key, dots: true });
      }
    }
    const [low, high] = chart.lines.map((l) => spread(l.x)).reduce(
      ([a, b], [c, d]) => [Math.min(a, c), Math.max(b, d)], [Infinity, -Infinity]);
    chart.draw(high > low ? [low, high] : [low - 1, low + 1]);
    axis.textContent = variable.selectedOptions[0] ? variable.selectedOptions[0].textContent : "";
  };
  const fill = () => {
    const [, rows] = sources[what.value], before = variable.value;
    const units = evidence.units;
    const names = ["time", ...Object.keys(rows[0].variables || {})];
    variable.replaceChildren(...names.map((n) =>
      make("option", { value: n }, named(n, n === "time" ? "s" : units[n]))));
    variable.value = names.includes(before) ? before : names[Math.min(1, names.length - 1)];
    draw();
  };
  place.append(make("p", { class: "controls" }, of, over), box, axis);
  fill();
  redraws.push(draw);
};

const explore = () => {
  const place = document.getElementById("explore");
  if (!place || !(evidence.series.length || evidence.residuals.length)) return;
  place.hidden = false;
  const redraws = [];
  const say = make("p", { class: "soft readout", "aria-live": "off" }, "Point at a chart for its values.");
  const panel = make("div", {});
  const linked = new Linked(panel, say);
  const names = [...new Set([...evidence.series, ...evidence.residuals].map((s) => s.recording))];
  let errors = false;
  const show = () => linked.show(chartsOf(recording.value, errors));
  const [which, recording] = choice("Recording", names.map((n) => [n, n]), show);
  const boxes = MODELS.filter(([key]) => evidence.series.some((s) => s[key])).map(([key, words]) => {
    const box = make("input", { type: "checkbox", onchange: () => { shown[key] = box.checked; redraws.forEach((f) => f()); } });
    box.checked = shown[key];
    return make("label", { class: key }, box, ` ${words}`);
  });
  const view = choice("Show", [["values", "outputs"], ["errors", "errors and residuals"]],
    (value) => { errors = value === "errors"; show(); })[0];
  const button = (text, title, act) => make("button", { type: "button", title, "aria-label": title, onclick: act }, text);
  place.append(
    make("p", { class: "controls" }, which, view, ...boxes),
    make("p", { class: "controls" }, button("+", "Zoom in", () => linked.zoom(0.6)),
      button("−", "Zoom out", () => linked.zoom(1.6)), button("◀", "Earlier", () => linked.move(-0.4)),
      button("▶", "Later", () => linked.move(0.4)), button("all", "All of it", () => linked.to(...linked.whole))),
    panel, say,
    make("p", { class: "soft" }, "Drag over a stretch to zoom in, with Shift to move, double-click for all; " +
      "all charts follow. Of long recordings a part of the samples is drawn."),
    make("h3", {}, "Residual over any variable"));
  redraws.push(() => linked.draw());
  scatter(place, redraws);
  show();
  let waiting = 0;
  const again = () => { cancelAnimationFrame(waiting); waiting = requestAnimationFrame(() => redraws.forEach((f) => f())); };
  window.addEventListener("resize", again);
  window.addEventListener("beforeprint", again);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", again);
  root.addEventListener("themechange", again);
  for (const opener of document.querySelectorAll("[data-models]")) {
    const keys = opener.dataset.models.split(" ");
    const open = () => {
      for (const [key] of MODELS.slice(1)) shown[key] = keys.includes(key);
      boxes.forEach((label) => { const box = label.firstChild; box.checked = shown[label.className]; });
      redraws.forEach((f) => f());
      place.scrollIntoView({ block: "start" });
    };
    opener.append(make("button", { type: "button", onclick: open }, "Show its fit and residual"));
  }
};

const copying = () => {
  const folder = decodeURIComponent(location.pathname.replace(/[^/]*$/, "")) || ".";
  for (const node of document.querySelectorAll("[data-copy]")) {
    const text = node.dataset.copy.replace("{folder}", folder);
    const button = make("button", { type: "button", onclick: async () => {
      try { await navigator.clipboard.writeText(text); } catch {
        const area = make("textarea", { class: "copied" });
        area.value = text;
        document.body.append(area);
        area.select();
        document.execCommand("copy");
        area.remove();
      }
      button.textContent = "copied";
      setTimeout(() => { button.textContent = node.dataset.words; }, 1500);
    } }, node.dataset.words);
    node.append(button);
    node.hidden = false;
  }
};

const theme = () => {
  const dark = () => root.dataset.theme ? root.dataset.theme === "dark"
    : window.matchMedia("(prefers-color-scheme: dark)").matches;
  const button = make("button", { type: "button", class: "theme", title: "Light or dark", "aria-label": "Light or dark",
    onclick: () => {
      root.dataset.theme = dark() ? "light" : "dark";
      root.dispatchEvent(new Event("themechange"));
    } }, "◐");
  document.body.prepend(button);
};

theme();
copying();
explore();

"use strict";
// Figures with data: drawn again so that they zoom, move and show values. Without scripts and on
// paper the drawing itself is seen.
(() => {
  const COLOURS = {/*COLOURS*/};
  const STEPS = 65534, GAP = 65535;
  const told = document.getElementById("told");
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const colour = (hex) => COLOURS[hex] ? css(`--${COLOURS[hex]}`) : hex;
  const faint = (hex) => `${colour(hex)}59`;

  const abscissas = (x) => Array.isArray(x) ? x : Array.from({ length: x.count }, (_, i) => x.from + (x.to - x.from) * i / Math.max(1, x.count - 1));
  const ordinates = (y) => {
    const raw = atob(y.codes), out = new Array(raw.length / 2);
    for (let i = 0; i < out.length; i++) {
      const code = raw.charCodeAt(2 * i) + 256 * raw.charCodeAt(2 * i + 1);
      out[i] = code === GAP ? null : y.low + (y.high - y.low) * code / STEPS;
    }
    return out;
  };
  const element = (tag, name, text) => { const out = document.createElement(tag); if (name) out.className = name; if (text) out.textContent = text; return out; };
  const button = (text, label, act) => { const out = element("button", "", text); out.type = "button"; out.setAttribute("aria-label", label); out.addEventListener("click", act); return out; };
  const minus = (number) => String(number).replaceAll("-", "−");
  const digits = (value) => value === null || value === undefined ? "–" : minus(Number(value.toPrecision(5)));
  const sizeOf = (panel) => Math.round(Math.max(110, Math.min(420, panel.height * 100))) + (panel.x ? 44 : 14);

  // Marks of a logarithmic axis, and those of them that carry a number.
  const decades = (low, high) => {
    const out = [], far = high > low * 1e9;
    for (let power = Math.floor(Math.log10(low)); power <= Math.ceil(Math.log10(high)); power++) {
      for (let first = 1; first <= (far ? 1 : 9); first++) { const value = Number(`${first}e${power}`); if (value >= low * (1 - 1e-9) && value <= high * (1 + 1e-9)) out.push(value); }
    }
    return out;
  };
  const named = (splits) => {
    const firsts = splits.length > 28 ? "1" : splits.length < 6 ? "123456789" : "125";
    return splits.map((value) => value !== null && firsts.includes(value.toExponential()[0]) ? value : null);
  };

  // One table of numbers for a panel: every curve over one common abscissa.
  const tableOf = (panel) => {
    const tables = [], nulls = [], looks = [];
    for (const curve of panel.curves) {
      const x = abscissas(curve.x), rows = [x, ordinates(curve.y)];
      looks.push({ curve, at: looks.length + 1, part: "y" });
      if (curve.kind === "band") { rows.push(ordinates(curve.top)); looks.push({ curve, at: looks.length + 1, part: "top" }); }
      tables.push(rows);
      nulls.push(rows.map(() => 1)); // a gap stays a gap
    }
    return { data: uPlot.join(tables, nulls), looks };
  };

  class Figure {
    constructor(figure) {
      this.figure = figure;
      this.panels = JSON.parse(figure.dataset.plot).panels;
      this.ranges = new Map();
      this.full = new Map();
      this.off = new Set();
      for (const panel of this.panels) {
        const group = panel.place[0], [low, high] = panel.xRange, known = this.full.get(group);
        this.full.set(group, known ? [Math.min(low, known[0]), Math.max(high, known[1])] : [low, high]);
      }
      this.place = element("div", "plot");
      this.place.setAttribute("role", "group");
      this.place.setAttribute("aria-label", `${figure.querySelector(".drawing").getAttribute("aria-label")}. Drag to zoom, double click to see all.`);
      this.toolbar();
      this.charts = [];
      this.grid = element("div", "panels");
      this.place.append(this.grid);
      figure.insertBefore(this.place, figure.querySelector(".drawing"));
      figure.classList.add("live");
      this.draw();
      new ResizeObserver(() => this.resize()).observe(this.place);
    }

    toolbar() {
      const bar = element("div", "tools");
      bar.append(
        button("+", "Zoom in", () => this.zoom(0.5)),
        button("−", "Zoom out", () => this.zoom(2)),
        button("←", "Move left", () => this.move(-0.25)),
        button("→", "Move right", () => this.move(0.25)),
        button("All", "Show all", () => this.reset()),
      );
      const labels = [...new Set(this.panels.flatMap((panel) => panel.curves.map((curve) => curve.label)).filter(Boolean))];
      for (const label of labels) {
        const curve = this.panels.flatMap((panel) => panel.curves).find((each) => each.label === label);
        const key = button("", `Curve: ${label}`, () => {
          this.off.has(label) ? this.off.delete(label) : this.off.add(label);
          key.setAttribute("aria-pressed", String(!this.off.has(label)));
          for (const { chart, looks } of this.charts) looks.forEach((look) => { if (look.curve.label === label) chart.setSeries(look.at, { show: !this.off.has(label) }); });
        });
        const sign = element("span", `sign ${curve.kind}${curve.dash?.length ? " dashed" : ""}`);
        sign.dataset.colour = curve.colour;
        key.className = "key";
        key.setAttribute("aria-pressed", "true");
        key.append(sign, document.createTextNode(label));
        bar.append(key);
      }
      this.place.append(bar);
      if (this.panels.length > 2) this.switches();
    }

    switches() {
      const fold = element("details", "channels"), list = element("div", "list");
      fold.append(element("summary", "", "Panels"), list);
      const nameOf = (panel) => this.quantityOf(panel) || panel.caption;
      const names = [...new Set(this.panels.map(nameOf))].filter(Boolean);
      for (const name of names) {
        const line = element("label"), box = document.createElement("input");
        box.type = "checkbox";
        box.checked = true;
        box.addEventListener("change", () => { for (const each of this.charts) if (nameOf(each.panel) === name) each.place.hidden = !box.checked; });
        line.append(box, document.createTextNode(name));
        list.append(line);
      }
      this.place.append(fold);
    }

    draw() {
      for (const each of this.charts) { each.chart.destroy(); }
      const hidden = new Set(this.charts.filter((each) => each.place.hidden).map((each) => each.panel));
      this.charts = [];
      this.grid.textContent = "";
      for (const sign of this.place.querySelectorAll(".sign")) sign.style.setProperty("--sign", colour(sign.dataset.colour));
      this.narrow = innerWidth < 700;
      const columns = 1 + Math.max(...this.panels.map((panel) => panel.place[2]));
      this.grid.style.gridTemplateColumns = this.narrow ? "minmax(0, 1fr)" : `repeat(${columns}, minmax(0, 1fr))`;
      for (const panel of this.panels) {
        const place = element("div", "panel"), values = element("div", "values");
        place.append(element("div", "title", this.headingOf(panel)), values);
        place.hidden = hidden.has(panel);
        if (!this.narrow && columns > 1) { place.style.gridColumn = String(panel.place[2] + 1); place.style.gridRow = String(panel.place[1] + 1); }
        this.grid.append(place);
        const { data, looks } = tableOf(panel);
        const chart = new uPlot(this.options(panel, looks, values, place.clientWidth), data, place);
        this.charts.push({ chart, panel, place, looks });
      }
    }

    // A panel of a grid has the quantity of its row and the heading of its column.
    headingOf(panel) {
      const grid = this.panels.some((each) => each.place[2] > 0);
      const top = grid && this.panels.find((each) => each.place[1] === 0 && each.place[2] === panel.place[2]);
      return [this.quantityOf(panel), panel.caption || top?.caption].filter(Boolean).join(" · ");
    }

    quantityOf(panel) {
      return panel.y || this.panels.find((each) => each.place[1] === panel.place[1] && each.place[2] === 0)?.y;
    }

    options(panel, looks, values, width) {
      const ink = css("--ink"), soft = css("--soft"), line = css("--line"), group = panel.place[0];
      const bands = [];
      const series = [{}, ...looks.map((look) => {
        const { curve, at, part } = look;
        if (curve.kind === "band") { if (part === "top") bands.push({ series: [at, at - 1], fill: faint(curve.colour) }); return { show: !this.off.has(curve.label), stroke: "transparent", width: 0, points: { show: false } }; }
        const stroke = colour(curve.colour);
        const points = { show: curve.kind === "points", size: Math.max(3, curve.width), fill: stroke, stroke, width: 0 };
        return { show: !this.off.has(curve.label), stroke, width: curve.kind === "points" ? 0 : Math.max(1, curve.width * 1.1), dash: curve.dash, points, ...(curve.kind === "points" ? { paths: () => null } : curve.kind === "held" ? { paths: uPlot.paths.stepped({ align: 1 }) } : {}) };
      })];
      const axis = { stroke: ink, grid: { stroke: line, width: 1 }, ticks: { stroke: line, width: 1 }, font: "12px system-ui, sans-serif" };
      // uPlot itself rounds to three decimals: 0.0025 would be 0.003, and 0.0004 would be 0.
      const linear = { values: (u, splits) => splits.map((value) => value === null ? "" : minus(Number(value.toPrecision(6)))) };
      const logarithmic = { splits: (u, axis, low, high) => decades(low, high), filter: (u, splits) => named(splits), values: (u, splits) => splits.map((value) => value === null ? "" : minus(Number(value.toPrecision(3)))) };
      const full = () => this.full.get(group);
      return {
        width: Math.max(200, width), height: sizeOf(panel), series, bands,
        legend: { show: false },
        cursor: { sync: { key: `${this.figure.id}-${group}`, setSeries: false }, drag: { x: true, y: false, setScale: false }, points: { size: 6 }, focus: { prox: -1 } },
        scales: {
          x: { time: false, ...(panel.logX ? { distr: 3 } : {}), range: () => this.ranges.get(group) ?? full() },
          y: { ...(panel.logY ? { distr: 3 } : {}), range: (u, low, high) => this.heights(panel, low, high) },
        },
        axes: [
          { ...axis, ...(panel.logX ? logarithmic : linear), size: panel.x ? 44 : 14, label: panel.x || undefined, labelSize: 18, labelFont: "12px system-ui, sans-serif", ...(panel.x ? {} : { values: (u, splits) => splits.map(() => "") }) },
          { ...axis, ...(panel.logY ? logarithmic : { ...linear, space: 15 }), size: 62 },
        ],
        hooks: {
          setSelect: [(u) => { if (u.select.width > 3) this.show(group, u.posToVal(u.select.left, "x"), u.posToVal(u.select.left + u.select.width, "x")); u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false); }],
          setCursor: [(u) => this.read(u, panel, looks, values)],
          ready: [(u) => this.hands(u, group)],
        },
      };
    }

    // Limits upward: those of the drawing while all is seen, else those of what is seen.
    heights(panel, low, high) {
      if (!this.ranges.has(panel.place[0]) || low === null || !isFinite(low)) return panel.yRange;
      if (panel.logY) return [Math.max(low / 1.3, panel.yRange[0] * 1e-3), high * 1.3];
      const room = 0.06 * (high - low) || 0.1 * Math.abs(high) || 1;
      return [low - room, high + room];
    }

    read(u, panel, looks, values) {
      const at = u.cursor.idx;
      if (at === null || at === undefined || u.cursor.left < 0) { values.textContent = ""; return; }
      const seen = looks.filter((look) => look.curve.label && look.curve.kind !== "band" && !this.off.has(look.curve.label));
      const parts = seen.map((look) => `${look.curve.label} ${digits(u.data[look.at][at])}`);
      const name = (this.panels.find((each) => each.place[0] === panel.place[0] && each.x)?.x || "x").replace(/ \(.*/, "");
      values.textContent = [`${name} ${digits(u.data[0][at])}`, ...parts].join(" · ");
    }

    // A double click shows all; the shift key moves, the control key with the wheel zooms.
    hands(u, group) {
      u.over.addEventListener("dblclick", () => this.reset());
      u.over.addEventListener("mousedown", (event) => {
        if (!event.shiftKey) return;
        event.preventDefault();
        event.stopImmediatePropagation();
        const [low, high] = this.ranges.get(group) ?? this.full.get(group), start = event.clientX;
        const move = (next) => { const by = (start - next.clientX) * (high - low) / u.over.clientWidth; this.show(group, low + by, high + by); };
        addEventListener("mousemove", move);
        addEventListener("mouseup", () => removeEventListener("mousemove", move), { once: true });
      }, { capture: true });
      u.over.addEventListener("wheel", (event) => {
        if (!event.ctrlKey) return;
        event.preventDefault();
        const x = u.posToVal(event.clientX - u.over.getBoundingClientRect().left, "x"), [low, high] = this.ranges.get(group) ?? this.full.get(group), by = event.deltaY < 0 ? 0.8 : 1.25;
        this.show(group, x - (x - low) * by, x + (high - x) * by);
      }, { passive: false });
    }

    show(group, low, high) {
      const [first, last] = this.full.get(group), span = Math.min(high - low, last - first);
      low = Math.max(first, Math.min(low, last - span));
      if (span >= 0.999 * (last - first)) this.ranges.delete(group); else this.ranges.set(group, [low, low + span]);
      for (const each of this.charts) if (each.panel.place[0] === group) { const [a, b] = this.ranges.get(group) ?? [first, last]; each.chart.setScale("x", { min: a, max: b }); }
      this.figure.dataset.zoomed = String(this.ranges.size > 0);
      told.textContent = this.ranges.has(group) ? `from ${digits(low)} to ${digits(low + span)}` : "all is shown";
    }

    zoom(by) { for (const group of this.full.keys()) { const [low, high] = this.ranges.get(group) ?? this.full.get(group), middle = (low + high) / 2; this.show(group, middle - (high - low) * by / 2, middle + (high - low) * by / 2); } }

    move(by) { for (const group of this.full.keys()) { const [low, high] = this.ranges.get(group) ?? this.full.get(group); this.show(group, low + by * (high - low), high + by * (high - low)); } }

    reset() { for (const [group, [low, high]] of this.full) this.show(group, low, high); }

    resize() {
      if (this.narrow !== innerWidth < 700) { this.draw(); return; }
      for (const { chart, panel, place } of this.charts) if (!place.hidden && place.clientWidth > 0 && Math.abs(place.clientWidth - chart.width) > 1) chart.setSize({ width: place.clientWidth, height: sizeOf(panel) });
    }
  }

  const drawn = [];
  const watcher = new IntersectionObserver((entries) => {
    for (const entry of entries) if (entry.isIntersecting) { watcher.unobserve(entry.target); drawn.push(new Figure(entry.target)); }
  }, { rootMargin: "400px" });
  for (const figure of document.querySelectorAll("figure[data-plot]")) watcher.observe(figure);
  const again = () => drawn.forEach((each) => each.draw());
  document.getElementById("theme").addEventListener("click", again);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", again);
})();

"use strict";
(() => {
  const MOST_ROWS = 6000, MOST_ESTIMATES = 2000;  // what is kept, whatever the length of the stream
  const by = (id) => document.getElementById(id);
  const canvases = new Map();
  let strips = [], times = [], columns = {}, history = [], last = null, final = null, over = false, dirty = true, frames = 0;

  function clear() { times = []; columns = {}; history = []; last = final = null; dirty = true; }

  function make(tag, text, kind) {
    const out = document.createElement(tag);
    if (text !== undefined) out.textContent = text;
    if (kind) out.className = kind;
    return out;
  }

  function chart(parent, id, caption) {
    const figure = make("figure"), canvas = make("canvas");
    canvas.setAttribute("role", "img");
    figure.append(caption, canvas);
    parent.append(figure);
    canvases.set(id, canvas);
    return figure;
  }

  function introduce(about) {
    by("name").textContent = about.name;
    document.title = about.name + " - flightid watch";
    strips = about.strips;
    by("strips").replaceChildren();
    for (const strip of strips) {
      const caption = make("figcaption");
      caption.append(make("b", strip.word), make("span", strip.unit, "soft"));
      chart(by("strips"), "strip " + strip.name, caption);
      canvases.get("strip " + strip.name).setAttribute("aria-label", strip.word + " over time");
    }
    by("h-delays").parentNode.hidden = !about.delays.length;
    by("delays").replaceChildren();
    for (const delay of about.delays) {
      const bar = make("span", undefined, "bar");
      bar.append(make("i"));
      by("delays").append(make("span", Math.round(delay * 10) / 10 + " ms"), bar, make("span", "-"));
    }
    if (about.loop) {  // margins of a loop: nothing is predicted, and intervals are of 95 %
      by("h-strips").textContent = "Measured";
      by("h-estimates").textContent = "Stability margins";
      by("meaning").textContent = "margin and its 95 % interval";
      by("standard").textContent = about.loop.standard;
    }
    by("ahead").hidden = Boolean(about.loop);
    by("demand").hidden = !about.loop;
    by("against").hidden = !about.reference;
    by("study").textContent = about.reference ? "reference " + about.reference : "";
  }

  function takeRows(rows) {
    const newest = times.length ? times[times.length - 1] : -Infinity;
    let first = 0;
    while (first < rows.t.length && rows.t[first] <= newest) first += 1;  // sent again after a lost connection
    for (const [name, values] of Object.entries(rows)) {
      const into = name === "t" ? times : (columns[name] = columns[name] || []);
      for (let at = first; at < values.length; at += 1) into.push(values[at]);
      if (into.length > 1.2 * MOST_ROWS) into.splice(0, into.length - MOST_ROWS);
    }
    dirty = true;
  }

  function takeEstimates(found) {
    if (last && found.t <= last.t) return;
    last = found;
    history.push(found);
    if (history.length > MOST_ESTIMATES) history = history.filter((_, at) => at % 2 === 0);
    if (!final) show(found);
  }

  function show(found) {
    by("kind").textContent = found.kind;
    by("h-delays").textContent = (found.kind.startsWith("refined") ? "Probability" : "Likelihood") + " of each delay";
    found.weights.forEach((weight, at) => {
      by("delays").children[3 * at + 1].firstChild.style.width = 100 * weight + "%";
      by("delays").children[3 * at + 2].textContent = weight.toFixed(3);
    });
    for (const item of found.items) {
      const id = "estimate " + item.name;
      if (!canvases.has(id)) {
        const caption = make("figcaption");
        for (const kind of ["word", "told", "reference", "off"]) caption.append(make(kind === "word" ? "b" : "span", "", kind));
        chart(by("estimates"), id, caption).dataset.name = item.name;
      }
      const canvas = canvases.get(id), figure = canvas.parentNode, cells = figure.firstChild.children;
      cells[0].textContent = item.word;
      cells[1].textContent = item.told + (item.unit && item.value !== undefined ? " " + item.unit : "");
      cells[2].textContent = item.reference_told ? "ref. " + item.reference_told : "";
      cells[3].textContent = item.off === undefined ? "" : (item.off > 0 ? "+" : "") + item.off.toFixed(1) + " sigmas" + (item.outside ? ", outside" : "");
      figure.className = item.outside ? "outside" : "";
      canvas.setAttribute("aria-label", item.word + " over time: " + cells[1].textContent);
    }
    for (const figure of by("estimates").children) {  // what is no longer determined is no number of now
      if (found.items.some((item) => item.name === figure.dataset.name)) continue;
      const told = figure.firstChild.children[1], words = ", no longer determined";
      if (told.textContent && !told.textContent.endsWith(words)) told.textContent += words;
      figure.className = "past";
    }
    dirty = true;
  }

  function stand(status) {
    by("state").textContent = status.state;
    by("rows").textContent = status.rows.toLocaleString("en");
    by("rate").textContent = status.state === "ended" ? "-" : status.rate.toFixed(status.rate < 100 ? 1 : 0) + " rows/s";
    by("last").textContent = status.t === null ? "-" : status.t.toFixed(2) + " s" + (status.silent >= 1 && status.state !== "ended" ? ", " + status.silent.toFixed(0) + " s ago" : "");
    by("left").textContent = status.left_out + (status.left_out === 1 ? " line, " : " lines, ") + status.spikes + (status.spikes === 1 ? " spike" : " spikes");
    by("sentence").textContent = status.sentence;
  }

  // Drawing: axes of round numbers, lines that stop where a sample is missing.
  function room(canvas) {
    const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
    if (!width || !height) return null;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    return { pen, left: 52, right: width - 8, top: 8, bottom: height - 20, width };
  }

  function ticks(low, high, count) {
    const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map((each) => each * power).find((each) => each >= raw) || raw;
    const out = [];
    for (let at = Math.ceil(low / step - 1e-9); at * step <= high + 1e-9 * step; at += 1) out.push(at * step);
    return { out, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
  }

  function axes(at, colours, x, y) {
    const px = (value) => at.left + (at.right - at.left) * (value - x[0]) / (x[1] - x[0]);
    const py = (value) => at.bottom - (at.bottom - at.top) * (value - y[0]) / (y[1] - y[0]);
    at.pen.font = "11px system-ui, sans-serif";
    at.pen.lineWidth = 1;
    at.pen.strokeStyle = colours.line;
    at.pen.fillStyle = colours.soft;
    const rows = ticks(y[0], y[1], 4), across = ticks(x[0], x[1], Math.max(2, Math.floor(at.width / 90)));
    at.pen.textAlign = "right"; at.pen.textBaseline = "middle";
    for (const value of rows.out) {
      at.pen.beginPath(); at.pen.moveTo(at.left, py(value)); at.pen.lineTo(at.right, py(value)); at.pen.stroke();
      at.pen.fillText(Math.abs(value) >= 1e5 || rows.digits > 4 ? value.toPrecision(2) : value.toFixed(rows.digits), at.left - 5, py(value));
    }
    at.pen.textAlign = "center"; at.pen.textBaseline = "top";
    for (const value of across.out) at.pen.fillText(value.toFixed(across.digits) + " s", Math.min(px(value), at.right - 12), at.bottom + 5);
    at.pen.save();
    at.pen.beginPath(); at.pen.rect(at.left, at.top - 4, at.right - at.left, at.bottom - at.top + 8); at.pen.clip();
    return { px, py };
  }

  function line(pen, xs, ys, from, colour, width, px, py) {
    pen.strokeStyle = colour; pen.lineWidth = width; pen.lineJoin = "round";
    pen.beginPath();
    let down = false;
    for (let at = from; at < xs.length; at += 1) {
      const value = ys[at];
      if (value === null || value === undefined) { down = false; continue; }
      if (down) pen.lineTo(px(xs[at]), py(value)); else pen.moveTo(px(xs[at]), py(value));
      down = true;
    }
    pen.stroke();
  }

  function limits(low, high) {
    if (!(high >= low)) return [-1, 1];
    const pad = 0.06 * (high - low) || 0.1 * Math.abs(high) || 1;
    return [low - pad, high + pad];
  }

  function drawStrip(strip, colours) {
    const at = room(canvases.get("strip " + strip.name));
    if (!at || times.length < 2) return;
    const end = times[times.length - 1], begin = Math.max(times[0], end - Number(by("span").value));
    let from = times.length - 1;
    while (from > 0 && times[from - 1] >= begin) from -= 1;
    const measured = columns[strip.name], predicted = columns[strip.name + "_expected"];
    let low = Infinity, high = -Infinity;
    for (let row = from; row < times.length; row += 1) {
      const value = measured[row];
      if (value !== null && value < low) low = value;
      if (value !== null && value > high) high = value;
    }
    const { px, py } = axes(at, colours, [begin, Math.max(end, begin + 1e-6)], limits(low, high));
    line(at.pen, times, measured, from, colours.measured, predicted ? 2.2 : 1.5, px, py);
    if (predicted) line(at.pen, times, predicted, from, colours.predicted, 1, px, py);
    at.pen.restore();
  }

  function ends(item) {  // of the band: the interval where one is given, else two sigmas
    return typeof item.low === "number" ? [item.low, item.high] : [item.value - 2 * item.std, item.value + 2 * item.std];
  }

  function drawEstimate(item, colours) {
    const at = room(canvases.get("estimate " + item.name));
    const shown = final && final.t > (last ? last.t : -Infinity) ? [...history, final] : history;
    const points = [];
    for (const each of shown) {
      const found = each.items.find((other) => other.name === item.name);
      if (found && typeof found.value === "number" && typeof found.std === "number") points.push([each.t, found.value, ...ends(found)]);
    }
    if (final && typeof item.value === "number") {
      if (points.length && points[points.length - 1][0] >= final.t) points.pop();
      points.push([final.t, item.value, ...ends(item)]);
    }
    if (!at) return;
    const spread = points.map(([, , low, high]) => [low, high]);
    // The later half sets the scale, so that the first guesses do not flatten what counts.
    const late = spread.slice(Math.floor(spread.length / 2));
    let low = Math.min(...late.map((each) => each[0])), high = Math.max(...late.map((each) => each[1]));
    const has = typeof item.reference === "number" && typeof item.reference_std === "number";
    if (has) { low = Math.min(low, item.reference - 2 * item.reference_std); high = Math.max(high, item.reference + 2 * item.reference_std); }
    const required = typeof item.required === "number";
    if (required) { low = Math.min(low, item.required); high = Math.max(high, item.required); }
    const begin = shown.length ? shown[0].t : 0, end = shown.length ? shown[shown.length - 1].t : 1;
    const { px, py } = axes(at, colours, [begin, Math.max(end, begin + 1)], limits(low, high));
    if (has) {
      const top = py(item.reference + 2 * item.reference_std), bottom = py(item.reference - 2 * item.reference_std);
      at.pen.fillStyle = colours.referenceBand;
      at.pen.fillRect(at.left, top, at.right - at.left, Math.max(1, bottom - top));
      line(at.pen, [begin, Math.max(end, begin + 1)], [item.reference, item.reference], 0, colours.reference, 1.5, px, py);
    }
    if (required) {
      at.pen.setLineDash([5, 4]);
      line(at.pen, [begin, Math.max(end, begin + 1)], [item.required, item.required], 0, colours.required, 1.2, px, py);
      at.pen.setLineDash([]);
    }
    if (points.length) {
      at.pen.fillStyle = colours.band;
      at.pen.beginPath();
      points.forEach(([x], row) => at.pen.lineTo(px(x), py(spread[row][1])));
      for (let row = points.length - 1; row >= 0; row -= 1) at.pen.lineTo(px(points[row][0]), py(spread[row][0]));
      at.pen.closePath(); at.pen.fill();
      line(at.pen, points.map((each) => each[0]), points.map((each) => each[1]), 0, colours.predicted, 1.6, px, py);
    }
    at.pen.restore();
  }

  function draw() {
    if (dirty && !document.hidden) {
      dirty = false;
      frames += 1;
      const style = getComputedStyle(document.documentElement), of = (name) => style.getPropertyValue(name).trim();
      const colours = { line: of("--line"), soft: of("--soft"), measured: of("--measured"), predicted: of("--predicted"), band: of("--band"), reference: of("--reference"), required: of("--required"), referenceBand: of("--reference-band") };
      for (const strip of strips) drawStrip(strip, colours);
      const now = final || last, newest = new Map();
      // What was determined before stays in its chart.
      for (const found of now ? [...history, now] : []) for (const item of found.items) newest.set(item.name, found === now ? item : { ...item, value: undefined });
      for (const item of newest.values()) drawEstimate(item, colours);
    }
    requestAnimationFrame(draw);
  }

  // The browser comes back by itself and says what it saw last; where the server refused it, this does.
  let seen = "";
  function connect() {
    const source = new EventSource("events" + (seen ? "?last=" + encodeURIComponent(seen) : ""));
    const told = (word, kind) => { by("connection").textContent = word; by("connection").className = "pill " + kind; };
    const on = (name, take) => source.addEventListener(name, (event) => { if (event.lastEventId) seen = event.lastEventId; take(JSON.parse(event.data)); });
    source.onopen = () => told("connected", "on");
    source.onerror = () => {
      if (over) return;
      told("connection lost, coming back", "off");
      if (source.readyState === EventSource.CLOSED) setTimeout(connect, 2000);
    };
    on("anew", clear);
    on("about", introduce);
    on("rows", takeRows);
    on("estimates", takeEstimates);
    on("status", stand);
    on("final", (found) => { final = found; show(found); });
    on("beat", () => {});
    on("bye", () => { over = true; source.close(); told("the watch has ended, the last numbers stand", ""); });
  }

  by("span").addEventListener("change", () => { dirty = true; });
  window.addEventListener("resize", () => { dirty = true; });
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { dirty = true; });
  // For tests: what the page holds.
  window.held = () => ({ rows: times.length, first: times[0], last: times[times.length - 1], times, estimates: history.length, final: final !== null, frames });
  connect();
  draw();
})();
